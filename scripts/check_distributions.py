"""Check the built distributions in a folder: what users need is in them, and nothing of this machine or of the tests is.

    python scripts/check_distributions.py dist

Prints one line for each distribution, and ends with exit code 1 where one of them is wrong.
"""

import io
import re
import sys
import tarfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
_FOREIGN = re.compile(r"(^|/)(tests|benchmarks|out|\.venv[^/]*|__pycache__)/|\.(mcap|jpg|pyc|onnx\.data)$")
_LARGEST_BYTES = 4_000_000


def read_distribution(path: Path) -> dict[str, bytes]:
    """Return the content of each file of a wheel or source distribution, by its path without the leading folder of a source."""
    if path.suffix == ".whl":
        with zipfile.ZipFile(path) as wheel:
            return {name: wheel.read(name) for name in wheel.namelist()}
    with tarfile.open(fileobj=io.BytesIO(path.read_bytes())) as source:
        files = [member for member in source.getmembers() if member.isfile()]
        return {one.name.partition("/")[2].removeprefix("src/"): source.extractfile(one).read() for one in files}  # type: ignore[union-attr]


def faults_of(path: Path) -> list[str]:
    """Return what is wrong with a distribution, one sentence each; empty where nothing is."""
    files = read_distribution(path)
    package = path.name.split("-")[0]
    (base,) = ROOT.glob(f"*/*/src/{package}")
    sources = (file for file in base.rglob("*") if file.is_file() and "__pycache__" not in file.parts)
    wanted = {str(file.relative_to(base.parent)) for file in sources}
    faults = [f"lacks {name}; see [tool.hatch.build] in pyproject.toml" for name in sorted(wanted - set(files))]
    faults += [f"holds {name}, which users do not need" for name in sorted(files) if _FOREIGN.search(name)]
    if path.stat().st_size > _LARGEST_BYTES:
        faults.append(f"is larger than {_LARGEST_BYTES / 1e6:g} MB")
    here = [str(place).encode() for place in (ROOT, Path.home()) if len(place.parts) > 2]
    faults += [
        f"names a folder of this machine in {name}" for name, data in files.items() if any(p in data for p in here)
    ]
    page = next((data for name, data in files.items() if name.endswith(("/METADATA", "PKG-INFO"))), b"").decode()
    relative = re.findall(r"\]\((?!https?://|#)([^)]*)\)", page)
    return faults + [f"has a link on its page that works in the repository only: {link}" for link in relative]


def main(folder: str) -> int:
    """Check all distributions of a folder."""
    paths = sorted([*Path(folder).glob("*.whl"), *Path(folder).glob("*.tar.gz")])
    if not paths:
        print(f"expected wheels and source distributions in {folder}, got none; run `make dist`", file=sys.stderr)
        return 1
    faults = [f"{path.name} {fault}" for path in paths for fault in faults_of(path)]
    print("\n".join(faults or [f"{path.name}: right, {path.stat().st_size / 1e6:.1f} MB" for path in paths]))
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:2] or ["dist"]))
