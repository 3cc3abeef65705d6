"""A single reflector that is moved to another place of the tool is missing neither before nor after."""

from __future__ import annotations

import numpy as np

from truing.stages.quality.names_and_surveys import between_appearances


def test_a_target_is_due_from_its_first_to_its_last_appearance() -> None:
    seen = np.array([[1, 0, 0], [0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0]], bool)
    due = np.array([[1, 0, 0], [1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0]], bool)
    np.testing.assert_array_equal(between_appearances(seen), due)
