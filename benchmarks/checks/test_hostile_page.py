"""What a hostile page of `benchmarks fuzz` sends: every kind of message, and the same in every run."""

import numpy as np

from benchmarks.fuzzing import hostile_page
from fdcal.viewer.server.client_values import COSTS, is_acceptable

SEEDS = 200  # connections whose messages are inspected


def test_the_cases_hold_every_kind_of_message_that_a_page_sends():
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
