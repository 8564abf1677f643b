"""The report in a headless Chromium: figures are drawn, the table sorts and filters, the player moves."""

import re

import numpy as np
import pytest
from browser import RULES, Opened, axe_source, chromium, open_page, serious_findings
from skd_evaluator.extensions.protocols.page import render as regulators_view
from skd_evaluator.extensions.protocols.result import Grid, GridCell, ProtocolResult
from skd_evaluator.report.html import page
from skd_evaluator.report.html.subjects import read_subjects
from skd_sim.world.episode import Mode


@pytest.fixture(scope="module")
def browser():
    with chromium() as one:
        yield one


@pytest.fixture(scope="module")
def subjects(browser, sweep):
    return read_subjects([sweep])


@pytest.fixture(scope="module")
def file(subjects, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(page.render(subjects), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def axe() -> str:
    return axe_source()


@pytest.fixture(scope="module")
def opened(browser, file) -> Opened:
    return open_page(browser, file)


def numbers(texts: list[str]) -> list[float]:
    return [np.nan if text == "–" else float(text.replace("−", "-")) for text in texts]


def test_figures_are_drawn(opened, subjects, file):
    charts = opened.page.locator(".chart").all()
    assert len(charts) == 4 + 3 + 1 + 1  # against C, margin against risk, margin against price, curves
    for chart in charts:
        assert chart.locator("svg .mark-symbol path, svg .mark-line path, svg .mark-rect path").count() >= 2
    shown = subjects[0].episodes
    assert opened.count("#maps svg") == len(shown.safe)
    least = sum(hit is not None for of_phi in shown.margin_hits for hit in of_phi)
    assert opened.count("#maps .psi.least") == opened.count("#maps .psi") == least
    opened.page.select_option("#map-objective", "deviation")
    mine = shown.collided & (shown.mode == Mode.KAMIKAZE) & (shown.objective == "deviation")
    assert opened.count("#maps .psi") == mine.sum()
    assert opened.count("#maps .psi.least") == 0
    opened.page.select_option("#subject", "1")
    assert opened.page.locator(".of-subject:visible").count() == 2  # failures, and each φ
    assert opened.page.locator(".of-subject[data-subject='1']:visible").count() == 2
    opened.assert_quiet(file)


def test_the_first_screen_has_the_worst_episode_and_where_the_car_hits(browser, subjects, tmp_path):
    (tmp_path / "page.html").write_text(page.render(subjects[1:]), encoding="utf-8")
    one, deadlock = open_page(browser, tmp_path / "page.html", 1280), subjects[1].figures["deadlock"]
    assert f"{100 * deadlock:.1f} % never pass" in one.text(".tiles")
    for place in ("#verdict", "#view svg", "#play", "#hits svg"):
        box = one.page.locator(place).bounding_box()
        assert box["y"] + box["height"] <= 900, place
    assert re.search(r"Safety margin \d\.\d{3} m \[\d\.\d{3}, \d\.\d{3}\]", one.text("#verdict"))
    episodes, scenario = subjects[1].episodes, subjects[1].scenario
    worst, least = int(episodes.worst_first()[0]), min(hit.distance for of in episodes.margin_hits for hit in of if hit)
    assert one.text("#playing").startswith("The worst of these episodes: ")
    assert f"The least deviation of the margin is {least:.2f} m, on synthetic/" in one.text("#place")
    assert "in contact" in one.text("#state")
    assert {one.page.locator(f"{place} text").first.text_content() for place in ("#view", "#hits")} == {"x, East ↓"}
    speed, time = re.search(r"at (\S+) m/s, (\S+) s after", one.text("#place")).groups()
    assert float(speed) == pytest.approx(episodes.impact_speed[worst], abs=0.051)
    assert float(time) == pytest.approx(episodes.impact_time[worst], abs=0.0051)
    assert one.count("#hits .end:not(.least)") == episodes.hit.sum()
    assert one.count("#hits .end.least") == sum(hit is not None for hits in episodes.margin_hits for hit in hits)
    assert one.count("#hits .ring") == 1
    for number in episodes.worst_first()[:20]:
        gap = np.abs(episodes.until_contact(number)[-1] - episodes.car_until_contact(number, scenario)[-1, :2])
        corner = gap[1] > scenario.car.front and gap[0] > scenario.car.half_width  # which R(1) counts as the front
        assert ("by the car's front corner" in one.text("#place")) == corner
        one.page.click("#next")
    one.page.context.close()


def test_the_table_sorts_and_filters(opened, subjects):
    every = sum(len(one.episodes) for one in subjects)
    assert opened.text("#count") == f"{every} of {every} episodes"
    speeds = np.concatenate([one.episodes.impact_speed for one in subjects])
    fastest = np.sort(speeds[np.isfinite(speeds)])
    head = opened.page.get_by_role("button", name="impact (m/s)")
    head.click()
    assert numbers(opened.column("impact (m/s)")) == pytest.approx(fastest[:25].tolist(), abs=0.0051)
    head.focus()
    opened.page.keyboard.press("Enter")
    assert numbers(opened.column("impact (m/s)")) == pytest.approx(fastest[::-1][:25].tolist(), abs=0.0051)
    assert opened.page.locator("#table th[aria-sort='descending']").inner_text().startswith("impact")
    opened.page.select_option("#outcome", "hit")
    opened.page.select_option("#objective", "along φ")
    hits = sum(int((one.episodes.hit & (one.episodes.mode == Mode.REPLAY)).sum()) for one in subjects)
    assert opened.text("#count") == f"{hits} of {every} episodes"
    assert set(opened.column("adversary")) == {"along φ"}
    opened.page.fill("#search", "synthetic/1 0.5")
    first = subjects[0].episodes
    names = [row["name"] for row in subjects[0].figures["per_safe_trajectory"]]
    mine = first.hit & (first.mode == Mode.REPLAY) & (first.safe_index == names.index("synthetic/1"))
    assert opened.text("#count") == f"{mine.sum()} of {every} episodes"
    for control in ("#outcome", "#objective"):
        opened.page.select_option(control, "")
    opened.page.fill("#search", "")
    opened.page.get_by_role("button", name="#", exact=False).first.click()


def test_the_player_moves(opened, subjects):
    place = "['cx', 'cy'].map((name) => document.querySelector('#view .user').getAttribute(name)).join()"
    opened.page.locator("#table tbody tr").nth(2).click()
    top = opened.page.evaluate("document.getElementById('player').getBoundingClientRect().top / window.innerHeight")
    assert 0.0 <= top <= 0.5  # where the row was clicked it was out of sight
    command = opened.text("#command")
    assert command.startswith("skd episode --mode ")
    assert command.endswith(f"--trial {opened.column('trial')[2]}")
    at_end = opened.page.evaluate(place)
    opened.page.focus("#time")
    opened.page.keyboard.press("Home")
    kamikaze = opened.column("adversary")[2] != "along φ"
    assert opened.count("#view .belief") == opened.count("#view .believed") == kamikaze
    assert ("the kamikaze believes the car" in opened.text("#state")) == kamikaze
    assert opened.page.locator(".of-belief:visible").count() == kamikaze
    assert opened.page.evaluate(place) != at_end
    assert opened.text("#clock").startswith("0.00 of ")
    opened.page.click("#play")
    opened.page.locator("#play", has_text="play").wait_for()  # it has come to its end
    assert opened.page.evaluate(place) == at_end
    opened.page.click("#charts summary")
    opened.page.locator("#distances svg > line[y1='30'][x1]").wait_for(state="attached")  # the time is marked at once
    opened.page.click("#next")
    assert opened.text("#command") != command
    assert opened.page.locator("#table tr.chosen").inner_text().startswith("▶ 4")


def test_it_fits_every_screen_and_paper(browser, file):
    backgrounds = set()
    for width, scheme in ((400, "dark"), (800, "light"), (1280, "light")):
        other = open_page(browser, file, width, scheme)
        assert other.page.evaluate("document.documentElement.scrollWidth") <= width
        other.page.evaluate("for (const one of document.querySelectorAll('details')) one.open = true")
        ends = "[...document.querySelectorAll('table, svg, pre')].map((one) => one.getBoundingClientRect().right)"
        assert max(other.page.evaluate(ends)) <= width  # nor does a table scroll sideways
        backgrounds.add(other.page.evaluate("getComputedStyle(document.body).backgroundColor"))
        other.assert_quiet(file)
        if width == 400:
            assert other.page.pdf().startswith(b"%PDF")
            other.page.emulate_media(media="print")
            other.page.set_viewport_size({"width": 688, "height": 900})  # A4 within margins of 14 mm
            assert max(other.page.evaluate(ends)) <= 688
        other.page.context.close()
    assert len(backgrounds) == 2


@pytest.fixture(scope="module")
def regulators_page(tmp_path_factory):
    """Seven impact places, green with a margin, and red."""
    places = (0.0, 10.0, 25.0, 50.0, 75.0, 90.0, 100.0)
    green = [GridCell(speed=60.0, place=one, colour="green", margin=0.3, margins=(0.3,), beyond=1) for one in places]
    hit = {"colour": "red", "impact_speed": 10.0, "margin": 0.0, "margins": (0.0,)}
    red = [GridCell(speed=20.0, place=one, **hit) for one in places]
    grid = Grid("cpna", "A pedestrian.", (*red, *green))
    path = tmp_path_factory.mktemp("ncap") / "protocol.html"
    view = ProtocolResult(skd="0", car="a car", seed=0, trials=1, margin_limit=9, grids=(grid,))
    path.write_text(regulators_view(view), encoding="utf-8")
    return path


@pytest.mark.parametrize(("width", "scheme"), [(400, "light"), (400, "dark"), (1280, "light"), (1280, "dark")])
def test_the_regulators_view_fits_a_telephone_in_its_colours(browser, regulators_page, axe, width, scheme):
    page = browser.new_context(viewport={"width": width, "height": 800}, color_scheme=scheme).new_page()
    page.goto(regulators_page.as_uri())
    assert page.evaluate("document.querySelector('table').getBoundingClientRect().right") <= width
    for name, colour in (("green", "rgb(0, 153, 51)"), ("red", "rgb(255, 51, 51)")):
        assert page.evaluate(f"getComputedStyle(document.querySelector('td.{name}')).backgroundColor") == colour
    clipped = "[...document.querySelectorAll('td')].filter((one) => one.scrollWidth > one.clientWidth).length"
    assert page.evaluate(clipped) == 0
    assert serious_findings(page, axe, RULES) == []
    page.context.close()


def test_axe_finds_nothing_serious(browser, file, axe):
    opened = open_page(browser, file, 400)
    for width in (400, 1280):
        opened.page.set_viewport_size({"width": width, "height": 900})
        for scheme, rules in (("light", RULES), ("dark", ["color-contrast"])):  # a scheme changes colours alone
            opened.page.emulate_media(color_scheme=scheme)
            assert serious_findings(opened.page, axe, rules) == [], (width, scheme)
    opened.page.context.close()
