"""Offsets near 2⁶³, whose differences are right although they themselves are not: memory was overwritten with them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from skd_evaluator.bags.logs import read_recordings
from skd_evaluator.campaign.store.manifest import write_manifests
from skd_evaluator.campaign.store.stored_episodes import read_episodes
from skd_sim.errors import UsageError

LARGEST = 2**63 - 1


def forged(folder: Path, name: str) -> None:
    """Write a result's arrays anew, of whose offsets the second and third lie at the ends of what there is."""
    with np.load(folder / "episodes.npz") as file:
        arrays = {key: file[key].copy() for key in file.files}
    arrays[name][1], arrays[name][2] = LARGEST, -2
    assert (np.diff(arrays[name])[:3] > 0).all()
    np.savez(folder / "episodes.npz", **arrays)
    write_manifests(folder)


@pytest.mark.parametrize(("name", "said"), [("offsets", "its offsets do not cut"), ("margin_offsets", "do not go")])
def test_they_are_refused(sweep: Path, tmp_path: Path, name: str, said: str) -> None:
    folder = tmp_path / "result"
    folder.mkdir()
    for one in ("episodes.npz", "assessment.json"):
        (folder / one).write_bytes((sweep / "synthetic" / "C_1" / one).read_bytes())
    forged(folder, name)
    with pytest.raises(UsageError, match=said):
        read_episodes(folder)
    if name == "offsets":
        with pytest.raises(UsageError, match="its offsets must increase"):
            read_recordings([folder])
