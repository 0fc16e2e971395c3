"""The notebooks run from top to bottom and are stored without what they print."""

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from nbformat import NotebookNode
from nbformat.v4 import new_code_cell, new_notebook

pytestmark = pytest.mark.slow
PATHS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
each_notebook = pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where kernels run: a folder of its own, with no settings or kernels of the user."""
    for name in ("IPYTHONDIR", "JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR"):
        monkeypatch.setenv(name, str(tmp_path / name.lower()))
    return tmp_path


def execute(name: str, notebook: NotebookNode, folder: Path) -> None:
    """Run all cells; the first that fails is shown, with its traceback."""
    resources = {"metadata": {"path": str(folder)}}
    client = NotebookClient(notebook, timeout=600, kernel_name="python3", resources=resources)
    try:
        client.execute()
    except CellExecutionError as error:
        plain = re.sub(r"\x1b\[[\d;]*m", "", str(error))
        pytest.fail(f"{name}: {plain}", pytrace=False)


def test_notebooks_are_found():
    assert len(PATHS) >= 1


@each_notebook
def test_runs(path, folder):
    execute(path.name, nbformat.read(path, as_version=4), folder)


@each_notebook
def test_stored_without_outputs(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.source for cell in code if cell.outputs or cell.execution_count is not None] == []
    assert notebook.metadata.kernelspec.name == "python3"
    assert (notebook.nbformat, notebook.nbformat_minor) == (4, 5)


def test_failure_shows_the_cell(folder):
    cells = [new_code_cell("divisor = 0"), new_code_cell("print(1 / divisor)"), new_code_cell("never = 1")]
    with pytest.raises(pytest.fail.Exception) as failure:
        execute("broken.ipynb", new_notebook(cells=cells), folder)
    message = str(failure.value)
    assert message.startswith("broken.ipynb")
    assert "print(1 / divisor)\n" in message
    assert "ZeroDivisionError" in message
    assert "never" not in message
