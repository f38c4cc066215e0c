"""The public names of steerkit.gym."""

from .lateral import LateralAcceleration as LateralAcceleration
from .stable_baselines import Network as Network
from .stable_baselines import PolicyBlock as PolicyBlock
from .stable_baselines import from_stable_baselines as from_stable_baselines
from .stable_baselines import stable_baselines_vec as stable_baselines_vec
from .task import Task as Task
from .vector_env import TrackSteering as TrackSteering
from .vector_env import TrackSteeringVector as TrackSteeringVector
