"""Options for XLA."""

from airpuck.compute import xla
from airpuck.compute.xla import cpu_options, for_batches


def test_this_version_knows_them_all():
    assert cpu_options() == xla._OPTIONS


def test_an_option_that_this_version_does_not_know_is_left_out(monkeypatch):
    known = {"xla_cpu_enable_fast_math": False}
    monkeypatch.setattr(xla, "_OPTIONS", {"xla_cpu_no_such_thing": 1, **known})
    cpu_options.cache_clear()
    try:
        assert cpu_options() == known
        assert for_batches(lambda x: x + 1)(1.0) == 2.0
    finally:
        monkeypatch.undo()
        cpu_options.cache_clear()
