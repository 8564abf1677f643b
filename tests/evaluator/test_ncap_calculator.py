"""Matrices, colours and points against Euro NCAP's own calculator, where the extra `ncap` is installed."""

import dataclasses
import logging
import random

import pytest
from skd_evaluator.extensions.protocols import matrices
from skd_evaluator.extensions.protocols.result import Grid, GridCell, points_of

TESTS = sorted({matrix.test for name in matrices.known_scenarios() if (matrix := matrices.matrix_of(name)) is not None})
GRIDS = 200


@pytest.fixture(scope="module")
def template():
    """The calculator's test points of each matrix, all rows of which brake, as it has them then.

    It is imported here alone, for it reads a workbook, which each process that collects tests would do.
    """
    integrity = pytest.importorskip("euroncap_rating_2026.crash_avoidance.integrity")
    from euroncap_rating_2026.common import PredictionColor
    from euroncap_rating_2026.crash_avoidance import data_model, matrix_processing, test_info

    logging.getLogger("euroncap_rating_2026").setLevel(logging.ERROR)
    sheets = integrity._pristine_dfs()
    found = {}
    for test in TESTS:
        name = "FC - Ped & Cyc pred." if test[:2] in ("CP", "CB") else "FC - Car & PTW pred."
        sheet = sheets[name]
        tests = matrix_processing.get_test_matrix(sheet, test, data_model.StageSubelementKey.FC)
        if test in ("CPLA day", "CBLA"):
            for one in tests:
                one.color = PredictionColor.GREEN
                one.attributes["Function"] = "AEB"
            left, removed, _ = test_info.collapse_cpla_cbla_aeb_duplicate_rows(sheet, tests, test)
            assert len(removed) == 2
            tests = matrix_processing.get_test_matrix(left, test, data_model.StageSubelementKey.FC)
        for one in tests:
            one.attributes["Function"] = "AEB"
        found[test] = tests
    return found


def kmh(text: str) -> float:
    return float(text.removesuffix(" km/h"))


def key_of(one) -> tuple[str, float, float, float | None]:
    said = one.attributes
    place = float(said["Impact location"].removesuffix("%")) if "Impact location" in said else None
    return said.get("Turn", ""), kmh(said["VUT speed"]), kmh(said["Target speed"]), place


def ours_in(name: str) -> dict[tuple[str, float, float, float | None], matrices.MatrixPoint]:
    turn = {"f": "Farside", "n": "Nearside"}[name[4]] if name[1:4] in ("pta", "bta") else ""
    return {(turn, point.speed, point.target, point.place): point for point in matrices.matrix_of(name).points}


def ours(test: str) -> dict[tuple[str, float, float, float | None], matrices.MatrixPoint]:
    return {key: point for name in matrices.scenarios_of(test) for key, point in ours_in(name).items()}


def random_value(draw: random.Random, criterion: matrices.Criterion, speed: float) -> float:
    """Often on an edge of a band: there a code of its own is wrong first."""
    if draw.random() < 0.4:
        return float(draw.choice([0, 10, 20, 30, 9.999999, 10.000001]))
    return round(draw.uniform(0.0, min(speed, 60.0)), 6)


@pytest.mark.parametrize("test", TESTS)
def test_the_matrices_are_those_of_the_calculators_template(template, test):
    theirs = {key_of(one): one.test_range.value.lower() for one in template[test]}
    assert {key: "standard" if point.standard else "extended" for key, point in ours(test).items()} == theirs


def test_colours_and_points_of_random_grids_are_the_calculators(template):
    from euroncap_rating_2026.common import PredictionColor
    from euroncap_rating_2026.crash_avoidance import data_model, matrix_processing, test_info

    draw = random.Random(5)
    seen = set()
    for number in range(GRIDS):
        test = TESTS[number % len(TESTS)]
        points, theirs, coloured = ours(test), [], {}
        for one in template[test]:
            point = points[key_of(one)]
            value = random_value(draw, point.criterion, point.speed)
            measured = matrix_processing.ComputedTestPoint(one, test, value).measured_color.value
            colour = matrices.colour_of(point.criterion, point.speed, value)
            assert colour == measured, (test, key_of(one), value)
            coloured[key_of(one)] = colour
            theirs.append(dataclasses.replace(one, color=PredictionColor(measured)))
            seen.add((point.criterion, colour))
        standard, extended = test_info.compute_predicted_score(test, theirs)
        (found,) = points_of(grids_of(test, coloured))
        assert found.why == ""
        assert (found.standard, found.extended) == (pytest.approx(standard), pytest.approx(extended))
        most = data_model.TOTAL_SCORES[test]
        assert (found.standard_most, found.extended_most) == (most["Standard"], most["Extended"])
    assert len(seen) == 5 + 2 + 3


def grids_of(test: str, coloured: dict[tuple[str, float, float, float | None], str]) -> list[Grid]:
    grids = []
    for name in matrices.scenarios_of(test):
        cells = tuple(
            GridCell(
                speed=point.speed,
                target=point.target,
                place=point.place,
                range="standard" if point.standard else "extended",
                colour=coloured[key],
            )
            for key, point in ours_in(name).items()
        )
        grids.append(Grid(name, "", cells, test))
    return grids


def test_half_a_matrix_has_no_points(template):
    coloured = dict.fromkeys(ours("CPTAfs & CPTAns"), "green")
    whole = grids_of("CPTAfs & CPTAns", coloured)
    assert points_of(whole)[0].standard == pytest.approx(1.0)
    (half,) = points_of(whole[:1])
    assert (half.standard, half.why) == (0.0, "20 of 25 tests have a colour; they are those of cptafs and cptans")
    blank = dataclasses.replace(whole[0].cells[0], colour="")
    left = [dataclasses.replace(whole[0], cells=(blank, *whole[0].cells[1:])), whole[1]]
    assert points_of(left)[0].why.startswith("24 of 25")
