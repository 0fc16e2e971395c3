"""Settings of the API documentation: `python -m sphinx -W -b html docs/api build/api`."""

import re
from pathlib import Path

from sphinx.application import Sphinx

import torchdt

project = "torchdt"
author = "The torchdt developers"
version = release = torchdt.__version__

extensions = ["sphinx.ext.apidoc", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
exclude_patterns = ["modules/modules.rst"]
default_role = "code"
html_theme = "alabaster"
html_theme_options = {
    "description": "Direct multiobject tracking in PyTorch",
    "page_width": "72rem",
    "sidebar_width": "18rem",
    "fixed_sidebar": True,
}
html_copy_source = False
html_show_copyright = False

# One page for each package, written anew by every build.
apidoc_modules = [
    {
        "path": str(Path(torchdt.__file__).parent),
        "destination": "modules",
        "max_depth": 1,
        "module_first": True,
        "automodule_options": {"members", "show-inheritance"},
    },
]

# What a package merely passes on is described where it is defined.
autodoc_default_options = {"ignore-module-all": True, "special-members": "__call__"}
autodoc_member_order = "bysource"
autodoc_use_type_comments = False  # there are none, and to look for them takes a quarter of the time
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False


def skip_alias(app: Sphinx, what: str, name: str, member: object, skip: bool, options: object) -> bool | None:
    """Leave out the fields of named tuples: the docstring of the class describes them."""
    return True if type(member).__name__ == "_tuplegetter" else None


def undo_types(app: Sphinx, what: str, name: str, member: object, options: object, lines: list[str]) -> None:
    """Types are in the signatures: nothing that comes before a colon or a comma is one.

    Sphinx would take a constant's `Columns: as many as fit` for a value of type `Columns`, and of attributes
    described together, `low, high: limits`, the first for the type of the second.
    """
    if lines and what in ("attribute", "data", "property") and lines[-1].startswith(":type: "):
        lines[:] = [f"{lines[-1].removeprefix(':type: ')}: {lines[0]}", *lines[1:-1]]
    for number, line in enumerate(lines):
        if found := re.match(r":ivar (\w+(?:, \w+)+):", line):
            lines[number] = line.replace(found[1], found[1].replace(", ", ","), 1)


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-skip-member", skip_alias)
    app.connect("autodoc-process-docstring", undo_types, priority=900)  # after napoleon
