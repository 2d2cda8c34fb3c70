"""The checks over a whole data set that is there."""

from pathlib import Path

from ninedtact.dataset.checks import CheckSettings, FileCheck, Untouched, checked_file, repeated
from ninedtact.dataset.report import Report, report_of
from ninedtact.dataset.sources.table import REFERENCES, pair_files
from ninedtact.dataset.workers import as_done


def check_folder(
    folder: Path, settings: CheckSettings = CheckSettings(), workers: int = 1, *, progress: bool = False
) -> Report:
    """Look at every pair; raises `DataSetDamaged`."""
    from tqdm import tqdm

    files = pair_files(folder)
    jobs = [(file, folder / REFERENCES, settings) for file in files]
    checks: dict[int, FileCheck] = {}
    with tqdm(unit="pair", disable=not progress) as bar:
        for number, check in as_done(check_of, jobs, workers):
            checks[number] = check
            bar.update(len(check.ids))
    return summed([checks[number] for number in range(len(files))], [file.name for file in files])


def check_of(file: Path, references: Path, settings: CheckSettings) -> FileCheck:
    """One file's, in a process of its own."""
    return checked_file(file, Untouched([references]), settings)


def summed(checks: list[FileCheck], names: list[str], dropped: bool = False) -> Report:
    """What each file tells by itself, and what is there twice."""
    own = [finding for check in checks for finding in check.findings]
    return report_of(sum(len(check.ids) for check in checks), [*own, *repeated(checks, names)], dropped)
