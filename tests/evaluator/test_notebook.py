"""Results in a notebook: a table of figures, of episodes, and arrays of trajectories."""

import re
import sys

import numpy as np
import pytest
from skd_evaluator import load_result
from skd_sim.errors import UsageError


@pytest.fixture(scope="module")
def result(sweep):
    return load_result(sweep / "synthetic" / "C_0.5")


def test_a_result_shows_itself(result):
    cells = re.findall(r">([^<]+)<", result._repr_html_())
    place = cells.index("margin (m)")
    low, high = result.figures["margin_ci95"]
    assert cells[place + 1 : place + 3] == [f"{result.figures['margin']:.3f}", f"[{low:.3f}, {high:.3f}]"]


def test_a_row_for_each_episode(result):
    pytest.importorskip("pandas")
    table = result.to_dataframe()
    along = table[table["mode"] == "replay"]
    assert len(along) == result.figures["collision_runs"]
    assert along["hit"].mean() == pytest.approx(result.figures["nominal_collision_rate"])
    planned = table[(table["objective"] == "deviation") & table["hit"]]
    groups = [planned.loc[planned["safe_index"] == index, "deviation"] for index in range(len(result.safe))]
    assert sum(map(len, groups)) == sum(int(np.isfinite(one).sum()) for one in result.groups["deviation"]) > 0


def test_trajectories_have_names_and_units(result):
    pytest.importorskip("xarray")
    data = result.to_xarray()
    assert data["adversary"].dims == ("episode", "time", "axis")
    assert data["time"].attrs["units"] == "s"
    for index, phi in enumerate(result.safe):
        np.testing.assert_array_equal(data["phi"][index, : len(phi)], phi)
        assert np.isnan(data["phi"][index, len(phi) :]).all()
    number = int(result.episodes.episode_id[3])
    own = np.flatnonzero(result.episodes.episode_id == number)
    assert len(data["adversary"].sel(episode=number, axis="x").values.reshape(-1, data.sizes["time"])) == len(own)


def test_what_is_not_installed_is_said(result, monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(UsageError, match=r"needs xarray: .* -m pip install .*'xarray>"):
        result.to_xarray()
