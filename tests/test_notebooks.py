"""Each notebook is kept twice, as .py to review and as .ipynb to open: both say the same."""

from pathlib import Path

import jupytext
import pytest

FOLDER = Path(__file__).parent.parent / "notebooks"


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.py")), ids=lambda p: p.stem)
def test_both_forms_hold_the_same_cells(path):
    script, notebook = (jupytext.read(path.with_suffix(end)) for end in (".py", ".ipynb"))
    cells = [[(c.cell_type, c.source) for c in form.cells] for form in (script, notebook)]
    assert cells[0] == cells[1], f"run: jupytext --to ipynb {path.name}"
