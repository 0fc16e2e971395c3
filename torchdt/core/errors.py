"""The errors that all bad input, and all storage that fails, raise."""

from typing import Self


class InputError(ValueError):
    """Input from outside that does not fit: a file, one of its keys, or an argument made from it."""

    @classmethod
    def of_key(cls, key: str, found: object, expected: object) -> Self:
        """Build the error of one key, in the form all messages share.

        Args:
            key: name of the array or setting at fault.
            found: what was there, in words.
            expected: what would have been right, in words.

        Returns:
            An error that reads ``key 'snapshots': found ..., expected ...``.
        """
        return cls(f"key '{key}': found {found}, expected {expected}")

    @classmethod
    def of_path(cls, path: object, found: object, expected: object) -> Self:
        """Build the error of a file as a whole: `path 'x.npz': found ..., expected ...`."""
        return cls(f"path '{path}': found {found}, expected {expected}")


class StorageError(OSError):
    """A file or folder that cannot be written; what was there before is as it was."""

    @classmethod
    def of_path(cls, path: object, error: OSError) -> Self:
        """Build the error of one file: `cannot write x.csv: No space left on device`."""
        return cls(f"cannot write {path}: {error.strerror or error}")


def require(holds: bool, key: str, found: object, expected: object) -> None:
    """Raise the `InputError` of a key where a condition does not hold."""
    if not holds:
        raise InputError.of_key(key, found, expected)


def one_line(error: Exception) -> str:
    """What a cell of a table takes of an error; the log has all of it."""
    return f"{type(error).__name__}: {error}".splitlines()[0]
