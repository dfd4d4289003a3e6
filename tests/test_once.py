"""Expensive objects are made once per session."""

from .apparatus import once


def test_workers_share_what_one_of_them_computed(tmp_path, monkeypatch):
    monkeypatch.setattr(once, "folder", tmp_path)
    made = []

    def square(number):
        made.append(number)
        return {"square": number**2}

    # Two workers, each with its own memory.
    one, other = once.once(square), once.once(square)
    assert one(2) == one(2) == other(2) == {"square": 4}
    assert other(3) == {"square": 9}
    assert made == [2, 3]


def test_without_a_folder_each_process_computes_its_own(monkeypatch):
    monkeypatch.setattr(once, "folder", None)
    made = []
    for _ in range(2):
        once.once(made.append)(1)
    assert made == [1, 1]
