"""What stands in a file twice is refused: one reader takes the first, another the last, and both have a figure."""

from __future__ import annotations

import pytest
from skd_sim.errors import UsageError
from skd_sim.inputs.files import parse_json


@pytest.mark.parametrize("text", ['{"margin": 9.9, "margin": 0.6}', '[{"a": {"b": 1, "margin": 2, "margin": 2}}]'])
def test_an_entry_of_json_is_there_once(text):
    """The last had counted."""
    with pytest.raises(UsageError, match=r"^here: not JSON that SKD reads: 'margin' stands twice in one object"):
        parse_json(text, "here")
