"""The API documentation is built without a warning and leaves out no module."""

import importlib
import inspect
import pkgutil
import re
import shutil
from pathlib import Path

import pytest
from sphinx.cmd.build import build_main
from sphinx.util.inventory import InventoryFile

import torchdt

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:The mapping interface for autodoc"),  # of Sphinx to itself
]
SOURCE = Path(__file__).parents[1] / "docs" / "api"


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """From a copy, which leaves the checkout as it is; pages of code would take a third of the time."""
    folder = tmp_path_factory.mktemp("docs")
    shutil.copy(SOURCE / "index.rst", folder)
    settings = (SOURCE / "conf.py").read_text()
    (folder / "conf.py").write_text(settings + 'extensions.remove("sphinx.ext.viewcode")\n')
    assert build_main(["-W", "--keep-going", "-q", "-b", "html", str(folder), str(folder / "html")]) == 0
    return folder / "html"


@pytest.fixture(scope="module")
def described(built):
    """Names by kind, as other projects find them."""
    inventory = InventoryFile.loads((built / "objects.inv").read_bytes(), uri="")
    return {kind: set(names) for kind, names in inventory.data.items()}


@pytest.fixture(scope="module")
def modules():
    names = [module.name for module in pkgutil.walk_packages(torchdt.__path__, "torchdt.")]
    return [name for name in names if not name.startswith("torchdt.conf")]


def test_every_module_appears(described, modules):
    assert len(modules) > 100
    assert set(modules) <= described["py:module"]


def test_every_public_function_and_class_appears(described, modules):
    for name in modules:
        module = importlib.import_module(name)
        for kind, test in (("py:function", inspect.isfunction), ("py:class", inspect.isclass)):
            own = {
                f"{name}.{key}"
                for key, value in inspect.getmembers(module, test)
                if value.__module__ == name and value.__name__ == key and not key.startswith("_")
            }
            exceptions = described["py:exception"] if kind == "py:class" else set()
            assert own <= described[kind] | exceptions


def test_there_is_a_page_for_each_package(built):
    pages = {path.stem for path in (built / "modules").glob("torchdt*.html")}
    root = Path(torchdt.__file__).parent
    folders = (path.parent.relative_to(root.parent) for path in root.rglob("__init__.py"))
    assert pages == {".".join(folder.parts) for folder in folders}


def test_attributes_that_share_a_description_keep_their_names(built):
    text = re.sub("<[^>]+>", "", (built / "modules" / "torchdt.model.html").read_text())
    assert "low,high – limits of the region" in text
