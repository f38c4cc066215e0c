"""The public names of steerkit.metrics."""

from .drive import GOOD as GOOD
from .drive import Criterion as Criterion
from .drive import Summary as Summary
from .drive import of_log as of_log
from .drive import summary as summary
from .signals import accelerations as accelerations
from .signals import largest as largest
from .signals import lateral_cost as lateral_cost
from .signals import lateral_jerk as lateral_jerk
from .signals import magnitude_at as magnitude_at
from .signals import rates as rates
from .signals import reversal_rate as reversal_rate
from .signals import rms as rms
from .signals import share_within as share_within
from .signals import time_over as time_over
from .table import TABLE as TABLE
from .table import Metric as Metric
from .table import measures as measures
from .table import measures_of_log as measures_of_log
from .table import r79_acceleration as r79_acceleration
from .table import r79_jerk as r79_jerk
from .table import wd_filter as wd_filter
from .table import weighted_acceleration as weighted_acceleration
