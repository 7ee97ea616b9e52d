"""Tables on a terminal or in a pipe; what they hold is for the command to say."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Sequence

import click

_WIDE_ENOUGH = 100


def print_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a ruled table on a wide terminal, and aligned columns, easy to grep, anywhere else."""
    if sys.stdout.isatty() and shutil.get_terminal_size().columns >= _WIDE_ENOUGH:
        from rich.console import Console
        from rich.table import Table
        from rich.text import Text

        table = Table(*head)
        for row in rows:
            table.add_row(*map(Text, row))  # Text: "[rad]" is a unit here, not markup
        Console().print(table)
        return
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    for row in (head, *rows):
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        click.echo("  ".join(cells).rstrip())
