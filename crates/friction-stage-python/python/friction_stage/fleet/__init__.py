"""Many variants and many recordings, on as many machines as it takes.

A job is cut into chunks. Each chunk is a pure function of a small input and writes one Parquet
file; any engine can compute it, twice or after a kill, with the same bytes. See ``map_variants``,
``map_sweep`` and ``identify_bags``, and ``python -m friction_stage.fleet`` for job files.
"""

try:
    import fsspec as _fsspec  # type: ignore[import-untyped]  # noqa: F401
    import pyarrow as _pyarrow  # type: ignore[import-untyped]  # noqa: F401
    import yaml as _yaml  # noqa: F401
except ImportError as _error:
    raise ImportError(
        f"fleets need more than the wheel ({_error}): pip install friction-stage[fleet]"
    ) from _error

from ..errors import FleetError, OtherJobError
from ._job import Bag, BagsJob, Job, SweepJob, VariantsJob, load_job
from ._job_files import kubernetes, slurm
from ._report import Report, report
from ._run import FleetResult, identify_bags, map_sweep, map_variants, run, run_share, status

__all__ = [
    "Bag",
    "BagsJob",
    "FleetError",
    "FleetResult",
    "Job",
    "OtherJobError",
    "Report",
    "SweepJob",
    "VariantsJob",
    "identify_bags",
    "kubernetes",
    "load_job",
    "map_sweep",
    "map_variants",
    "report",
    "run",
    "run_share",
    "slurm",
    "status",
]
