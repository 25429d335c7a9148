"""Broken files and messages, as of `benchmarks fuzz`, a few of each."""

import numpy as np
import pytest

from benchmarks.fuzzing import examine, hostile_page
from benchmarks.fuzzing.readers import READERS, Reader


@pytest.mark.parametrize("name", READERS)
def test_broken_files_are_refused_in_one_line(name):
    found = (examine.faults_apart if READERS[name].apart else examine.faults)(name, 0, READERS[name].cases)
    assert not found, "\n".join(found[:3])


@pytest.mark.parametrize(
    ("read", "words"),
    [
        (lambda path: 1 / 0, "ZeroDivisionError"),
        (lambda path: (path.parent / "left").touch(), "left behind"),
        (lambda path: examine.signal.pause(), "Hang"),
    ],
)
def test_a_reader_at_fault_is_found(read, words, tmp_path, monkeypatch):
    monkeypatch.setattr(examine, "WAIT", 1)
    path = tmp_path / "file"
    path.touch()
    assert words in examine.fault_of(Reader("", print, read), path)


# What a hostile page sends, the same in every run: an honest page goes on, and the server logs no error.


MESSAGES, SEEDS = 20, 200  # connections, and those whose messages are looked at alone


def test_no_message_of_a_page_disturbs_another():
    found = hostile_page.page_faults(0, MESSAGES)
    assert not found, "\n".join(found[:3])


def test_the_cases_hold_every_kind_of_message_that_a_page_sends():
    from fdcal.viewer.server.client_values import COSTS, is_acceptable

    def sent(seed):
        return hostile_page.hostile_messages(np.random.default_rng(seed), ["a", "b"])

    assert sent(3) == sent(3) and sent(3) != sent(4)
    kinds, accepted = set(), set()
    for raw in (raw for seed in range(SEEDS) for raw in sent(seed)):
        try:
            message = hostile_page.msgspec.msgpack.decode(raw)
            kinds.add(message["type"])
            accepted |= {message["type"]} if is_acceptable(message) else set()
        except (TypeError, KeyError, ValueError):
            continue
    assert kinds >= COSTS.keys() and accepted == COSTS.keys()
