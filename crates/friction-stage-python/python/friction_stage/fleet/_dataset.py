"""The data set: what the Parquet file of a chunk holds, and whose it is.

The bytes of a file depend on its rows and on its chunk alone.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]
from numpy.typing import NDArray

from ..errors import FleetError

DATA = "data"
"""Directory of the files."""

FINGERPRINT = b"friction_stage.fingerprint"
CHUNK = b"friction_stage.chunk"

VARIANT_COLUMNS = (
    "peak_error_m",
    "settling_time_s",
    "saturated",
    "stiffness",
    "bristle_damping",
    "viscous_friction",
    "coulomb_force",
    "static_force",
    "stribeck_velocity",
)

PARAMETER = pa.struct(
    [
        # `declared` for what the model declares, else the name of an effect.
        ("owner", pa.string()),
        ("name", pa.string()),
        ("value", pa.float64()),
        ("unit", pa.string()),
        ("low", pa.float64()),
        ("high", pa.float64()),
    ]
)

BAG_SCHEMA = pa.schema(
    [
        ("bag", pa.string()),
        ("machine", pa.string()),
        # s since the epoch of the recording's clock.
        ("recorded_s", pa.float64()),
        ("sha256", pa.string()),
        ("verdict", pa.string()),
        ("effects", pa.list_(pa.string())),
        ("explained_share", pa.float64()),
        ("train_force_rms_before", pa.float64()),
        ("train_force_rms_after", pa.float64()),
        ("holdout_force_rms_before", pa.float64()),
        ("holdout_force_rms_after", pa.float64()),
        ("parameters", pa.list_(PARAMETER)),
        ("warnings", pa.list_(pa.string())),
        ("model", pa.string()),
        ("summary", pa.string()),
    ]
)


def file_name(index: int) -> str:
    """The file of a chunk."""
    return f"{DATA}/chunk-{index:08}.parquet"


def variants_table(
    columns: Mapping[str, NDArray[Any]], guides: Sequence[str], point: Mapping[str, Any]
) -> pa.Table:
    """Variants as rows; the settling time of what never settled is missing."""
    rows = len(columns["variant"])
    arrays: dict[str, pa.Array] = {
        key: pa.array([value] * rows) for key, value in sorted(point.items())
    }
    arrays["guide"] = pa.array(np.asarray(guides, dtype=object)[columns["guide"]], pa.string())
    for name in ("variant", "seed"):
        arrays[name] = pa.array(columns[name], pa.uint64())
    for name in VARIANT_COLUMNS:
        arrays[name] = pa.array(columns[name], from_pandas=name == "settling_time_s")
    return pa.table(arrays)


def sweep_table(columns: Mapping[str, Any]) -> pa.Table:
    """Points as rows, with the columns of ``sweep``; what has no value is missing."""
    return pa.table(
        {
            name: pa.array(values, pa.string())
            if isinstance(values, list)
            else pa.array(values, from_pandas=True)
            for name, values in columns.items()
        }
    )


def bag_table(row: Mapping[str, Any]) -> pa.Table:
    """One bag as a row."""
    return pa.Table.from_pylist([dict(row)], schema=BAG_SCHEMA)


def to_bytes(table: pa.Table, fingerprint: str, index: int) -> bytes:
    """The file of a chunk."""
    whose = {FINGERPRINT: fingerprint.encode(), CHUNK: str(index).encode()}
    table = table.replace_schema_metadata(whose)
    file = io.BytesIO()
    pq.write_table(
        table,
        file,
        compression="zstd",
        compression_level=3,
        row_group_size=65_536,
        use_dictionary=[one.name for one in table.schema if one.type == pa.string()],
    )
    return file.getvalue()


def whose(file: Any) -> tuple[str, int, int]:
    """Fingerprint of the job, index of the chunk, and rows of a file.

    Raises:
        FleetError: It is no whole file of a chunk.
    """
    try:
        footer = pq.read_metadata(file)
        said = footer.metadata or {}
        return said[FINGERPRINT].decode(), int(said[CHUNK]), footer.num_rows
    except (pa.ArrowException, KeyError, ValueError, OSError) as error:
        raise FleetError(f"it is not the whole file of a chunk: {error}") from error
