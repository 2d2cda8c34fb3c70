"""The library of Parquet files, from its extra."""

from ninedtact.errors import NinedtactError

try:
    import pyarrow as pa
    import pyarrow.parquet as pq
except ModuleNotFoundError as missing:
    raise NinedtactError(
        f"expected the libraries of data sets, got no {missing.name}; install them: pip install 'ninedtact[datasets]'"
    ) from missing

__all__ = ["pa", "pq"]
