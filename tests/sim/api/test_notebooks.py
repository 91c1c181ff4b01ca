"""The notebooks run from the first cell to the last, in a kernel of their own."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

from tests.support import ROOT
from tests.support.launching import assert_nothing_left, private_runtime_dir

NOTEBOOKS = sorted((ROOT / "sim" / "notebooks").glob("*.ipynb"))


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
@pytest.mark.filterwarnings("default")  # of the notebook client's own libraries
def test_a_notebook_runs(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    notebook = nbformat.read(path, as_version=4)  # type: ignore[no-untyped-call]
    stored = [
        cell for cell in notebook.cells if cell.cell_type == "code" and cell.outputs
    ]
    assert not stored, "a stored output would grow old"
    with private_runtime_dir() as folder:
        monkeypatch.setenv("HAPTIC_RUNTIME_DIR", str(folder))
        NotebookClient(notebook, timeout=120, kernel_name="python3").execute(
            cwd=str(folder)
        )
        assert_nothing_left(folder)
    shown = [
        output
        for cell in notebook.cells
        if cell.cell_type == "code"
        for output in cell.outputs
    ]
    assert not any(output.output_type == "error" for output in shown)
    assert any("image/png" in output.get("data", {}) for output in shown)
