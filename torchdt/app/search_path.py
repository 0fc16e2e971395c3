"""Where Hydra looks for configuration: in the package, and in folders of jobs that live outside of it."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.plugins import Plugins
from hydra.plugins.search_path_plugin import SearchPathPlugin

_folders: list[Path] = []


class FurtherFolders(SearchPathPlugin):
    """Adds the folders of `configuration_from` to those of Hydra, also for what a job composes itself."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """Called by Hydra whenever it begins."""
        for folder in _folders:
            search_path.append("torchdt", f"file://{folder}")


Plugins.instance().register(FurtherFolders)


@contextlib.contextmanager
def configuration_from(*folders: Path) -> Iterator[None]:
    """Let Hydra, where it begins inside, find what these folders hold, after the package's configuration."""
    _folders.extend(folders)
    try:
        yield
    finally:
        del _folders[len(_folders) - len(folders) :]
