"""The public names of steerkit.gym."""

from .task import Task as Task
from .vector_env import LateralAcceleration as LateralAcceleration
from .vector_env import Network as Network
from .vector_env import PolicyBlock as PolicyBlock
from .vector_env import TrackSteering as TrackSteering
from .vector_env import TrackSteeringVector as TrackSteeringVector
from .vector_env import from_stable_baselines as from_stable_baselines
from .vector_env import stable_baselines_vec as stable_baselines_vec
