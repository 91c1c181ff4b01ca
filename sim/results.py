"""Result files of studies: earlier files of the same name are moved, never overwritten."""

import sys
import time
from pathlib import Path

EARLIER = "earlier"  # folder beside the results, with a subfolder for each run that moved files
_moved: dict[Path, Path] = {}  # by results folder: where this run moves earlier files


def fresh(path: Path) -> Path:
    """Move an earlier file of this name to ``earlier/DATE-TIME/``.

    The move is reported on standard error, once per run.
    """
    folder = path.parent
    folder.mkdir(parents=True, exist_ok=True)
    if path.exists():
        aside = _moved.get(folder)
        if aside is None or (aside / path.name).exists():
            aside = _moved[folder] = _new(folder / EARLIER)
            print(
                f"{folder}: files of an earlier run are kept in {aside}",
                file=sys.stderr,
                flush=True,
            )
        path.rename(aside / path.name)
    return path


def _new(folder: Path) -> Path:
    name = time.strftime("%Y%m%d-%H%M%S")
    for number in range(1, 1000):
        made = folder / (name if number == 1 else f"{name}-{number}")
        try:
            made.mkdir(parents=True)
        except FileExistsError:
            continue
        return made
    raise FileExistsError(f"{folder}: a thousand folders of the same second")
