"""Tables as CSV files, each written whole or not at all."""

import csv
import io
import os
from collections.abc import Iterable, Mapping, Sequence

from torchdt.core.atomic import atomic_write


def write_csv(path: str | os.PathLike[str], header: Sequence[str], rows: Iterable[Iterable[object]]) -> None:
    """Write a header and rows of cells; None is an empty cell."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    with atomic_write(path) as file:
        file.write(buffer.getvalue().encode())


def write_table(path: str | os.PathLike[str], rows: Sequence[Mapping[str, object]]) -> None:
    """Write rows with the columns of the first one; lists are left out."""
    columns = [key for key, value in rows[0].items() if not isinstance(value, list)]
    write_csv(path, columns, ([row.get(column) for column in columns] for row in rows))
