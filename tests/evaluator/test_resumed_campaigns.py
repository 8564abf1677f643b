"""A campaign is gone on with for the same car alone."""

from __future__ import annotations

import pytest
from skd_evaluator.extensions.campaign.campaign import CampaignFolder
from skd_evaluator.extensions.campaign.campaign_file import read_campaign
from skd_evaluator.extensions.campaign.cells import make_cells
from skd_sim.errors import UsageError

SIZES = "safe_count: 1, kamikaze_count: 1, collision_runs: 1, simulations: 10, margin_limit: 0, behaviour: none"
CAR = """
from pathlib import Path
from the_law import decide
class Car:
    def __init__(self): self.gain = float(Path(__file__).with_name("weights.bin").read_text())
    def reset(self, scenario, rng): pass
    def command(self, car, adversary): return decide(self.gain)
"""


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("weights.bin", "2"),
        ("the_law.py", "def decide(gain): return gain\n"),
        ("nets/new.bin", "1"),
        ("weights.bin", None),
    ],
)
def test_another_car_behind_the_same_module_is_refused(here, monkeypatch, name, text):
    monkeypatch.syspath_prepend(str(here))
    (here / "read_car.py").write_text(CAR)
    (here / "the_law.py").write_text("def decide(gain): return -gain\n")
    (here / "weights.bin").write_text("1")
    (here / "nets").mkdir()
    (here / "cars.yaml").write_text(f"defaults: {{{SIZES}}}\ncars: [{{controller: 'read_car:Car'}}]\n")
    combinations = read_campaign(here / "cars.yaml")
    cells = make_cells(combinations)
    CampaignFolder(here / "out", cells).close()
    CampaignFolder(here / "out", cells, resume=True).close()
    monkeypatch.setattr("skd_evaluator.extensions.campaign.cells.check_car", lambda _values, scenario, **_how: scenario)
    CampaignFolder(here / "out", make_cells(combinations), resume=True).close()  # what it has written is no other car
    if text is None:
        (here / name).unlink()
    else:
        (here / name).write_text(text)
    with pytest.raises(UsageError) as caught:
        CampaignFolder(here / "out", make_cells(combinations), resume=True)
    assert f"file.{here / 'read_car.py'} of cell read_car-Car has changed from" in str(caught.value)
