"""Users' files that misbehave, and what becomes of it."""

#: Misbehaviour of user code.
MISDEEDS = {
    "exits": "sys.exit(0)",
    "exits in words": "sys.exit('bye')",
    "raises": "raise ValueError('no')",
    "raises an exception that is never caught": "raise BaseException('no')",
    "raises what cannot be shown": "raise Unspeakable",
    "raises an error of ours": "airpuck.SetPoint('here', 0, 0)",
    "never returns from itself": "forever()",
    "stops a generator": "raise GeneratorExit",
    "says nothing": "assert False",
}


COMMON = """
import sys
import numpy as np
import airpuck

class Unspeakable(Exception):
    def __str__(self): raise SystemExit

def forever(): return forever()

def wrong():
    print("here I am")
    {misdeed}

class Where:
    {at}def at(self, now, ahead): wrong()
    {asked}def asked(self, now): wrong()
    {over}def over(self, now, ahead): wrong()
    {fine}def at(self, now, ahead): return airpuck.SetPoint(-0.8, 0, 0).at(now, ahead)
"""


class _Only(dict):
    """Comments out the misbehaving lines except at one place."""

    def __missing__(self, key):
        return "" if key in self["place"] else "pass  # "


def written(folder, text, place, misdeed="raise ValueError('no')", where="Where()"):
    """Write a file that misbehaves at one place, and return FILE.py:NAME."""
    words = _Only(place=place.split(), misdeed=misdeed, where=where)
    if "at" not in words["place"]:
        words["place"].append("fine")
    (folder / "mine.py").write_text((COMMON + text).format_map(words))
    return f"{folder / 'mine.py'}:Mine"


def one_line(error, name, capsys):
    assert "\n" not in str(error.value)
    assert name in str(error.value)
    assert "line " in str(error.value)
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "here I am" in printed.err
