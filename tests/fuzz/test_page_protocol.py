"""What a hostile page sends, the same in every run: an honest page goes on, and the server logs no error.

`python -m benchmarks fuzz` tries 10,000.
"""

import numpy as np

from benchmarks.fuzzing import hostile_page

CASES, SEEDS = 80, 200  # connections, and those whose messages are looked at alone


def test_no_message_of_a_page_disturbs_another():
    found = hostile_page.page_faults(0, CASES)
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
