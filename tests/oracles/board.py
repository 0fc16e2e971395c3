"""A TensorBoard server, asked over HTTP what it shows."""

import contextlib
import json
import os
import re
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

DEADLINE_S = 180
"""After which a server that shows nothing has failed; far longer than a slow machine takes."""

Ask = Callable[..., Any]


@contextlib.contextmanager
def serve(logdir: str | os.PathLike[str], log: Path) -> Iterator[Ask]:
    """Serve the event files of a folder on a free port of this machine until the block ends.

    Args:
        logdir: the folder.
        log: file for what the server says.

    Yields:
        A function that takes a route below `/data/plugin`, and a body to post or None, and gives the answer.
    """
    command = [sys.executable, "-m", "tensorboard.main", f"--logdir={logdir}", "--host=127.0.0.1", "--port=0"]
    with log.open("w") as file, subprocess.Popen(command, stdout=file, stderr=file) as server:
        try:
            address = until(lambda: _address(server, log))

            def ask(route: str, body: object = None) -> Any:
                data = None if body is None else json.dumps(body).encode()
                request = urllib.request.Request(
                    f"{address}/data/plugin/{route}", data, {"Content-Type": "application/json"}
                )
                with urllib.request.urlopen(request, timeout=DEADLINE_S) as answer:
                    return json.load(answer)

            yield ask
        finally:
            server.kill()


def until(look: Callable[[], Any]) -> Any:
    """What a function gives once it is something."""
    end = time.monotonic() + DEADLINE_S
    while not (found := look()):
        assert time.monotonic() < end, f"nothing within {DEADLINE_S} s"
        time.sleep(0.1)
    return found


def _address(server: subprocess.Popen, log: Path) -> str | None:
    assert server.poll() is None, log.read_text()
    found = re.search(r"at (http://127\.0\.0\.1:\d+)", log.read_text())
    return found and found[1]
