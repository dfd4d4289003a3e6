"""Parsing message definitions within limits.

rosbags compiles a definition to code, with a line for each element of an array of messages or
texts. Its IDL parser tries every alternative in each pair of brackets, and evaluates constant
expressions. A definition of a few bytes can therefore grow without bound.
"""

from __future__ import annotations

import re
from typing import Any

from airpuck.boundary.limits import DEFINITION_BYTES, DEFINITION_SIZE, MESSAGE_BYTES
from airpuck.recording.cdr import Types

#: Comments and texts of IDL, in which brackets and operators mean nothing.
_MEANINGLESS = re.compile(r'"(?:\\.|[^"\\])*+"|//[^\n]*|/\*.*?\*/', re.DOTALL)
#: Where IDL may have an expression.
_EXPRESSION = re.compile(r"[@=(\[<,+-]")
#: The brackets of annotations; all others, products, shifts and single bits are computations.
_ANNOTATION = re.compile(r"@[\w:]++\s*+\(")
_COMPUTED = re.compile(r"[(*/%|^&~]|<<")
#: Cost of a type, of an element of an array of texts or types, and of an expression, in fields.
_FIELDS_PER_TYPE, _FIELDS_PER_ELEMENT, _FIELDS_PER_EXPRESSION = 20, 2, 5


def parse_definition(msgtype: str, text: str, *, idl: bool) -> Types:
    """Parse the definition of a message type and of the types that it contains."""
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    if len(text) > DEFINITION_BYTES:
        raise ValueError(
            f"the embedded definition of {msgtype} is longer than {DEFINITION_BYTES:,} characters"
        )
    if idl:
        # Several files follow each other, each under two lines that rosbags' parser does not know;
        # nor does it know #include, but the files included are among them.
        foreign = ("=" * 80, "IDL: ", "#")
        text = "\n".join(line for line in text.splitlines() if not line.startswith(foreign))
        meant = _ANNOTATION.sub("@=", _MEANINGLESS.sub("", text))
        if _COMPUTED.search(meant):
            raise ValueError(f"the embedded definition of {msgtype} computes with constants")
        _check_size(_FIELDS_PER_EXPRESSION * len(_EXPRESSION.findall(meant)), msgtype)
    try:
        types = get_types_from_idl(text) if idl else get_types_from_msg(text, msgtype)
    # A damaged definition can make the parser fail in any way.
    except Exception as error:
        raise ValueError(f"the embedded definition of {msgtype} cannot be parsed") from error
    _check_size(sum(_code_size(fields, msgtype) for _, fields in types.values()), msgtype)
    return types


def _check_size(size: int, msgtype: str) -> None:
    if size > DEFINITION_SIZE:
        raise ValueError(f"{msgtype} is defined with more than {DEFINITION_SIZE:,} elements")


def _code_size(fields: Any, msgtype: str) -> int:
    """Return how much code a type makes, in fields; refuse arrays that no message can hold."""
    from rosbags.interfaces import Nodetype

    size = _FIELDS_PER_TYPE + len(fields)
    for name, (node, description) in fields:
        if node != Nodetype.ARRAY:
            continue
        (kind, of), count = description
        if not 0 < count <= MESSAGE_BYTES:
            raise ValueError(f"{msgtype} is defined with {count:,} elements of {name}")
        if kind == Nodetype.NAME or of[0] == "string":
            size += _FIELDS_PER_ELEMENT * count
    return size
