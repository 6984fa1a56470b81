"""The explorer's page in a real Chromium: its numbers are the Python face's, and nobody else is served."""

from __future__ import annotations

import http.client
import json
import random
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from urllib.parse import urlencode, urlsplit
from zipfile import ZipFile

import pytest

from geometry.scenes.scene_file import read_scene
from probe_design import Scene, evaluate, optimize
from probe_design.explorer.session import Session
from probe_design.explorer.variables import get_value
from tests.support.explorer import PATIENCE_MS, kill_worker, open_browser, serve_pages
from tests.support.paths import ROOT

sync_api = pytest.importorskip("playwright.sync_api")
EXAMPLE = ROOT / "examples" / "scene.toml"


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with serve_pages(str(EXAMPLE)) as (address, _):
        yield address


@pytest.fixture(scope="module")
def browser() -> Iterator[sync_api.Browser]:
    with open_browser() as browser:
        yield browser


def open_page(browser: sync_api.Browser, address: str) -> sync_api.Page:
    page = browser.new_context(accept_downloads=True).new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.goto(address)
    page.wait_for_selector("[data-output=ratio]")
    return page


def wait_for_ratio(page: sync_api.Page, ratio: float) -> None:
    page.wait_for_function(f"() => Number(document.querySelector('[data-output=ratio]')?.dataset.value) === {ratio!r}")


def wait_for_area_ratio(page: sync_api.Page, scene: Scene) -> None:
    """Wait until the page shows the ratio of a scene with the area ratio as typed: a drag is drawn in several steps."""
    for _ in range(PATIENCE_MS // 100):
        typed = page.get_by_label("area ratio A2/A1, value").input_value()
        shown = page.locator("[data-output=ratio]").get_attribute("data-value") or "nan"
        if float(shown) == evaluate(scene.replace({"probe.area_ratio": float(typed)}), evaluator="closed-form").ratio:
            return
        page.wait_for_timeout(100)
    raise AssertionError(f"the page shows {shown}, which is not the ratio with an area ratio of {typed}")


def drag_slider(page: sync_api.Page, label: str, fraction: float) -> None:
    """Drag the handle of a slider to a fraction of its length."""
    slider = page.locator(f".q-slider[aria-label='{label}']")
    track, handle = slider.locator(".q-slider__track-container").bounding_box(), slider.locator(".q-slider__thumb").bounding_box()
    assert track is not None
    assert handle is not None
    y = handle["y"] + handle["height"] / 2
    page.mouse.move(handle["x"] + handle["width"] / 2, y)
    page.mouse.down()
    page.mouse.move(track["x"] + fraction * track["width"], y, steps=10)
    page.mouse.up()


def ask(address: str, path: str = "/", **headers: str) -> tuple[int, dict[str, str]]:
    """Return status and headers of a response."""
    parts = urlsplit(address)
    assert parts.hostname == "127.0.0.1"
    with closing(http.client.HTTPConnection("127.0.0.1", parts.port, timeout=60)) as connection:
        connection.request("GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()})
        with connection.getresponse() as response:
            return response.status, {name.lower(): value for name, value in response.headers.items()}


def test_only_the_browser_with_the_token_is_served(address: str) -> None:
    query = "/?" + urlsplit(address).query
    assert [ask(address, path)[0] for path in ("/", "/?token=wrong", query + "x", "/_nicegui/components")] == [403] * 4
    status, headers = ask(address, query)
    cookie = headers["set-cookie"]
    assert (status, headers["location"]) == (303, "/")
    assert {"HttpOnly", "SameSite=Strict"} <= {part.strip() for part in cookie.split(";")}
    assert urlsplit(address).query.removeprefix("token=") not in cookie
    cookie = cookie.split(";")[0]
    assert ask(address, Cookie=cookie)[0] == 200
    assert ask(address, Cookie=cookie[:-1])[0] == 403
    assert ask(address, query, Host="rebound.example")[0] == 403
    socket_path = "/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
    upgrade = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec_WebSocket_Version": "13",
        "Sec_WebSocket_Key": "A" * 22 + "==",
    }
    for path, others in (("/", {}), (socket_path, upgrade)):
        for foreign in ({"Origin": "http://127.0.0.1:1"}, {"Origin": "null"}, {"Host": "rebound.example"}):
            assert ask(address, path, Cookie=cookie, **others, **foreign)[0] == 403
    assert ask(address, socket_path, **upgrade)[0] == 403


def test_visit(address: str, browser: sync_api.Browser, tmp_path: Path) -> None:
    page, other = open_page(browser, address), open_page(browser, address)
    hosts: set[str] = set()
    page.on("request", lambda request: hosts.add(urlsplit(request.url).hostname or ""))
    assert "token" not in page.url
    start = evaluate(read_scene(EXAMPLE), evaluator="closed-form")
    wait_for_ratio(page, start.ratio)
    gap = page.get_by_label("gap, value")
    gap.fill("0,5")
    gap.press("Enter")
    wider = evaluate(read_scene(EXAMPLE).replace({"probe.gap": "0.5 mm"}), evaluator="closed-form")
    wait_for_ratio(page, wider.ratio)
    page.wait_for_function("() => location.hash.includes('probe.gap=0.5')")
    page.reload()  # the address holds the design
    wait_for_ratio(page, wider.ratio)
    gap.fill("-1")
    gap.press("Enter")
    page.get_by_text("probe.gap = '-1 mm'").wait_for()
    assert page.locator("[data-output=ratio]").get_attribute("data-value") == repr(wider.ratio)
    with page.expect_download() as download:
        page.get_by_role("button", name="Scene TOML").click()
    download.value.save_as(tmp_path / "scene.toml")
    assert evaluate(tmp_path / "scene.toml", evaluator="closed-form").ratio == wider.ratio
    page.get_by_role("button", name="Undo").click()
    wait_for_ratio(page, start.ratio)
    wait_for_ratio(other, start.ratio)
    assert "gap" not in other.url
    for junk in ("null", "7", "'x'", "{name: 9, x: 1, depth: 1}", "{name: 0, x: 'NaN', depth: 1}", "{name: 0, depth: []}"):
        page.evaluate(f"emitEvent('explorer_move', {junk})")
    page.locator("[data-tumour]").press("ArrowDown")
    deeper = read_scene(EXAMPLE).replace({"inclusion.depth": "9.5 mm"})
    wait_for_ratio(page, evaluate(deeper, evaluator="closed-form").ratio)
    page.locator("[data-edge=hole]").press("ArrowRight")
    inner, hole, outer = deeper.probe.inner_radius, deeper.probe.hole_radius + 0.05e-3, deeper.probe.tube_radius
    sizes = {"probe.gap": "0.15 mm", "probe.area_ratio": float(f"{inner**2 / (outer**2 - hole**2):.6g}")}
    wait_for_ratio(page, evaluate(deeper.replace(sizes), evaluator="closed-form").ratio)
    assert hosts == {"127.0.0.1"}


@pytest.mark.slow
def test_every_slider_changes_its_number() -> None:
    session = Session(read_scene(EXAMPLE))
    for key, variable in session.variables.items():
        value = variable.find_value(0.55)
        session.change({key: variable.format_value(value)})
        assert get_value(session.scene, key) == pytest.approx(value, rel=1e-12)
        assert get_value(session.start.replace({key: value}), key) == get_value(session.scene, key)
    assert len(session.variables) == 12
    before = session.scene
    session.change({"probe.area_ratio": "1,5"})
    assert session.scene.probe.area_ratio == 1.5
    assert session.undo()
    assert session.scene == before


@pytest.mark.slow
def test_ten_pages_at_once_and_a_killed_process(browser: sync_api.Browser) -> None:
    """Each page shows the ratio of its own gap, also after the process of the formulas was killed, which the page says."""
    with serve_pages(str(EXAMPLE)) as (address, server):
        pages = [open_page(browser, address) for _ in range(10)]
        for turn in range(2):
            gaps = [f"0.{20 + 2 * k + turn} mm" for k in range(len(pages))]
            for page, gap in zip(pages, gaps, strict=True):
                page.get_by_label("gap, value").fill(gap)
                page.get_by_label("gap, value").press("Enter")
            for page, gap in zip(pages, gaps, strict=True):
                wait_for_ratio(page, evaluate(read_scene(EXAMPLE).replace({"probe.gap": gap}), evaluator="closed-form").ratio)
        kill_worker(server)
        pages[0].get_by_label("gap, value").press("Tab")
        pages[0].get_by_role("button", name="Undo").click()
        wait_for_ratio(pages[0], evaluate(read_scene(EXAMPLE).replace({"probe.gap": "0.20 mm"}), evaluator="closed-form").ratio)
        pages[0].get_by_text("the process of the formulas ended: its process was ended by SIGKILL").wait_for()
        for page in pages:
            page.context.close()


@pytest.mark.slow
def test_a_better_design_by_hand(address: str, browser: sync_api.Browser, tmp_path: Path) -> None:
    """Sliders are dragged, the design is checked by a named evaluator, downloaded, and evaluated by the command."""
    page = open_page(browser, address)
    wider = read_scene(EXAMPLE).replace({"probe.gap": "0.5 mm"})
    drag_slider(page, "gap", 1.0)  # from 0.1 mm to the end
    wait_for_ratio(page, evaluate(wider, evaluator="closed-form").ratio)
    assert page.get_by_label("gap, value").input_value() == "0.5 mm"
    drag_slider(page, "area ratio A2/A1", 0.2)
    page.wait_for_function("() => document.querySelector('[data-output=log_sensitivity]').dataset.value > 0.06")
    wait_for_area_ratio(page, wider)
    page.get_by_label("evaluator").click()
    page.get_by_role("option", name="axisymmetric").click()
    page.get_by_role("button", name="Check").click()
    page.get_by_text("checked by axisymmetric").wait_for()
    checked = page.locator("table.outputs tbody tr").first.locator("td").nth(1).get_attribute("data-value")
    with page.expect_download() as download:
        page.get_by_role("button", name="Scene TOML").click()
    download.value.save_as(tmp_path / "scene.toml")
    command = [sys.executable, "-m", "probe_design", "evaluate", "--evaluator", "axisymmetric", "--json"]
    better, start = (
        json.loads(subprocess.run([*command, str(path)], capture_output=True, check=True).stdout)
        for path in (tmp_path / "scene.toml", EXAMPLE)
    )
    assert better["ratio"] == pytest.approx(float(checked or "nan"), rel=1e-9)  # rounding of a worker
    assert better["log_sensitivity"] > 1.3 * start["log_sensitivity"]


@pytest.mark.slow
def test_an_optimised_design_is_accepted(address: str, browser: sync_api.Browser, tmp_path: Path) -> None:
    page = open_page(browser, address)
    page.get_by_role("button", name="Optimise from here").click()
    page.get_by_role("button", name="Accept").wait_for()
    optimum = optimize(read_scene(EXAMPLE))
    wanted = evaluate(optimum.scene, evaluator="closed-form")
    verified = evaluate(optimum.scene)
    heads = page.locator("table.outputs th").all_inner_texts()
    for heading, result in (("optimised, closed-form", wanted), (f"optimised, {verified.evaluator}", verified)):
        column = next(k for k, head in enumerate(heads) if head.startswith(heading))
        shown = page.locator("table.outputs tbody tr").first.locator("td").nth(column - 1).get_attribute("data-value")
        assert float(shown or "nan") == pytest.approx(result.ratio, rel=1e-3)  # of a search on another processor
    page.get_by_role("button", name="Accept").click()
    page.get_by_text("the optimised design is accepted").wait_for()
    with page.expect_download() as download:
        page.get_by_role("button", name="Scene TOML").click()
    download.value.save_as(tmp_path / "scene.toml")
    accepted = evaluate(tmp_path / "scene.toml", evaluator="closed-form")
    assert accepted.ratio == pytest.approx(wanted.ratio, rel=1e-4)  # six digits of each number
    wait_for_ratio(page, accepted.ratio)
    with page.expect_download() as download:
        page.get_by_role("button", name="Workshop").click()
    with ZipFile(download.value.path()) as archive:
        assert archive.testzip() is None
        assert {"assembly.step", "inner.dxf", "bill-of-materials.csv", "scene.toml"} <= set(archive.namelist())


@pytest.mark.slow
def test_random_events(address: str, browser: sync_api.Browser) -> None:
    """After twelve seconds of events at random, floods and malformed messages the page shows what it is asked for."""
    page, chance, end = open_page(browser, address), random.Random(41), time.monotonic() + 12
    start = Session(read_scene(EXAMPLE))
    labels = [f"{variable.label}, value" for variable in start.variables.values()]
    sliders = page.locator(".q-slider [tabindex]")
    buttons = ("Undo", "Redo", "Keep A", "Keep B", "Dark/light", "Check", "Cancel")
    junk = ("{}", "null", "7", "{id: 'x', client_id: 'y', listener_id: 'z', args: []}")

    def type_text() -> None:
        entry = page.get_by_label(chance.choice(labels), exact=True)
        entry.fill(chance.choice(("", "abc", "1e999 mm", "-5", "0,3", "7 kPa", "9" * 400, "<b>", "nan mm")))
        entry.press("Enter")

    def drag() -> None:
        x, y = chance.uniform(330, 800), chance.uniform(100, 400)
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + chance.uniform(-40, 40), y + chance.uniform(-40, 40), steps=4)
        page.mouse.up()

    events = (
        type_text,
        drag,
        lambda: sliders.nth(chance.randrange(len(labels))).press(chance.choice(("ArrowLeft", "ArrowRight", "Home", "End"))),
        lambda: page.get_by_role("button", name=chance.choice(buttons)).click(),
        lambda: page.evaluate(f"window.socket.emit('event', {chance.choice(junk)})"),
        lambda: page.evaluate(
            "for (let k = 0; k < 1000; k++) emitEvent('explorer_move', { name: '0', x: (k % 99) / 50, depth: 8 + (k % 50) / 25 })"
        ),
    )
    while time.monotonic() < end:
        chance.choice(events)()
    page.evaluate("for (let k = 0; k < 10000; k++) emitEvent('explorer_edge', { name: 'hole', x: 4 + (k % 99) / 100, depth: 0 })")
    values = {key: variable.format_value(get_value(start.scene, key) or 0.0) for key, variable in start.variables.items()}
    page.evaluate("fragment => emitEvent('explorer_open', fragment)", urlencode(values))
    wait_for_ratio(page, evaluate(start.scene, evaluator="closed-form").ratio)
