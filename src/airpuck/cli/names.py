"""Names of files on the command line: inputs and outputs, checked beforehand."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from airpuck.boundary.errors import InputError
from airpuck.boundary.outputs import Output, check_output

#: Key in a command's context: its outputs, and the option of each.
_OUTPUTS = "airpuck.outputs"
#: Number of characters shown of a name that is too long.
_SHOWN = 40


def check_written(context: Any, option: str, path: Path, kind: Output) -> None:
    """Reject an output that cannot be written, or that another option uses, before any work."""
    taken: dict[Path, str] = context.meta.setdefault(_OUTPUTS, {})
    whole = path.absolute()
    if whole in taken:
        raise InputError(f"is also the output of {taken[whole]}", file=path, field=option)
    check_output(path, kind, field=option)
    taken[whole] = option


def check_inputs(context: Any) -> None:
    """Reject invalid names, and outputs that are also inputs."""
    outputs: dict[Path, str] = context.meta.get(_OUTPUTS, {})
    for parameter in context.command.params:
        written = parameter.opts[0] in outputs.values()
        for name in () if written else _texts(context.params.get(parameter.name)):
            try:
                found = os.stat(name)  # noqa: PTH116
            except OSError as error:
                if error.errno == errno.ENAMETOOLONG:
                    shown = f"{str(name)[:_SHOWN]}…"
                    problem = "is a longer name than the system allows"
                    raise InputError(problem, file=shown, field=parameter.opts[0]) from None
                continue
            for output, option in outputs.items():
                if output.exists() and os.path.samestat(output.stat(), found):
                    raise InputError(
                        "is also an input; choose another name", file=name, field=option
                    )


def refuse_empty(arguments: list[str]) -> None:
    """Reject an empty name; it would mean the current folder."""
    for before, argument in zip(["", *arguments], arguments, strict=False):
        option, _, value = argument.partition("=")
        if not argument:
            field = before if before.startswith("-") else None
            raise InputError("an argument is empty; type a name", field=field)
        if option.startswith("--") and argument.endswith("=") and not value:
            raise InputError("is empty; type a name", field=option)


def _texts(value: Any) -> Iterator[str | Path]:
    """Yield the texts and paths of a parameter."""
    for one in value if isinstance(value, (list, tuple)) else (value,):
        if isinstance(one, (str, Path)):
            yield one
