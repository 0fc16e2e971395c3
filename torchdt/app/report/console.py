"""Where tables and messages are printed: names and errors as they are, whoever chose them."""

from rich.console import Console


def plain_console() -> Console:
    """A console for standard output that takes no text for its own: neither `[red]` nor `:smile:`."""
    return Console(markup=False, emoji=False)


def printable(text: str) -> str:
    """Text that any encoding of standard output takes; names of files need not be text."""
    return text.encode(errors="backslashreplace").decode()
