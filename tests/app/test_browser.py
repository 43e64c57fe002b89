"""The page in a real browser: scans in, numbers read, another cable clicked, a region drawn, the report saved."""

import re
import signal
import subprocess
import sys

import pytest

from cablejax.io import write_points
from cablejax.measure import measure_cables
from tests.app.browser import BROWSERS, browser, found_browser
from tests.app.scans import two_cables

pytest.importorskip("websocket", reason="the browser is driven through websocket-client, which Jupyter brings")
pytestmark = pytest.mark.skipif(
    found_browser() is None, reason=f"no browser: expected one of {', '.join(BROWSERS)} (Debian: apt install chromium)"
)
CANVAS = "document.getElementById('canvas').getBoundingClientRect()"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("scans")
    write_points(path / "two.ply", two_cables())
    (path / "broken.ply").write_bytes((path / "two.ply").read_bytes()[:-1000])
    return path


@pytest.fixture(scope="module")
def app(folder):
    """The command, running, and what it printed at the end."""
    command = [sys.executable, "-m", "cablejax.cli", "app", "--no-browser"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=folder)
    assert process.stdout is not None
    yield process, process.stdout.readline().strip()
    process.kill()
    process.wait()


@pytest.fixture(scope="module")
def page(app, tmp_path_factory):
    with browser(tmp_path_factory.mktemp("downloads")) as one:
        one.size(1280, 800)
        one.open(app[1])
        yield one
        assert one.said == []  # no error of the page's scripts


@pytest.fixture(scope="module")
def truth():
    return [one.diameter_mm for one in measure_cables(two_cables()).cables]


def test_a_scan_is_uploaded_and_its_cables_measured(page, folder, truth):
    page.choose("#file", folder / "two.ply")
    page.wait("document.querySelectorAll('#cables button').length == 2", seconds=120)
    found = [float(x) for x in re.findall(r": ([\d.]+) mm", page.text("#cables"))]
    assert found == pytest.approx(truth, abs=2e-3)  # rounded to a thousandth, and one thread adds otherwise than two
    assert page.text("#diameter") == f"{found[1]:.3f} mm"  # the one that more points rest on
    assert "95 % interval" in page.text("#interval")
    assert "6,000 points" in page.text("#shown")
    assert "cablejax measure two.ply --all" in page.text("#command")


def test_another_cable_is_clicked_in_the_scan(page):
    # On the tag's side away from it: the cable's own points, not the button.
    x, y = page.middle("#tags button")
    place = (x + 60, y)
    page.mouse("mousePressed", *place)
    page.mouse("mouseReleased", *place)
    page.wait("document.querySelector('#cables button').getAttribute('aria-pressed') == 'true'", seconds=10)
    assert page.text("#diameter").startswith("20.0")
    page.click("#tags button:nth-child(2)")
    assert page.text("#diameter").startswith("28.0")


def test_the_slider_moves_the_section(page):
    def at() -> float:
        return float(re.search(r"at ([\d.]+) mm", page.text("#place")).group(1))

    page.wait("document.querySelectorAll('#section path').length > 0", seconds=20)
    before = at()
    page.run(
        "(() => { const s = document.getElementById('along'); s.value = 250; s.dispatchEvent(new Event('input')); })()"
    )
    page.wait(f"!document.getElementById('place').innerText.startsWith('at {before:.1f} mm')", seconds=20)
    assert at() == pytest.approx(before / 2, abs=0.2)
    assert re.search(r"\d+ points within 3.5 mm", page.text("#sectiontext"))


def test_the_report_is_saved(page):
    page.wait("!document.getElementById('report').disabled", seconds=60)
    page.click("#report")
    html = page.downloaded("two-cable-2.html").read_text()
    assert "two.ply, cable 2: 28.0" in html
    page.click("#reportall")
    assert "two.ply" in page.downloaded("two.html").read_text()


def test_a_region_is_drawn_about_one_cable_and_measured(page):
    page.click("#select")
    first, second = (page.middle(f"#tags button:nth-child({number})")[1] for number in (1, 2))
    left, width = page.run(f"(({{x, width}}) => [x, width])({CANVAS})")
    top, bottom = sorted((first, second))
    edge = (top + bottom) / 2
    inside = (edge, bottom + 120) if first == bottom else (top - 120, edge)
    page.drag((left + 5, inside[0]), (left + width - 5, inside[1]))
    page.wait("document.getElementById('box0').value != ''", seconds=10)
    assert float(page.run("document.getElementById('box4').value")) < 30  # y: the second cable begins at 46
    page.click("#again")
    page.wait("document.getElementById('command').innerText.includes('--box')", seconds=30)
    page.wait(
        "document.querySelector('#scans .what').innerText.includes('20.0') && document.getElementById('busy').hidden",
        seconds=120,
    )
    assert page.run("document.querySelectorAll('#cables button').length") == 1
    assert page.text("#diameter").startswith("20.0")


def test_a_broken_file_dropped_on_the_page_is_told_in_a_sentence_and_the_next_is_measured(page, folder):
    page.drop("#view", folder / "broken.ply", folder / "two.ply")
    page.wait("document.querySelectorAll('#scans li').length == 3", seconds=60)
    page.click("#scans li:nth-child(2) .open")
    page.wait("document.getElementById('trouble').innerText.startsWith('broken.ply: is truncated')", seconds=60)
    assert page.run("document.getElementById('found').hidden")
    page.click("#scans li:nth-child(3) .open")
    page.wait("document.querySelectorAll('#cables button').length == 2", seconds=120)
    assert page.run("document.getElementById('trouble').hidden")
    page.click("#scans li:nth-child(2) .away")
    page.wait("document.querySelectorAll('#scans li').length == 2", seconds=20)


def test_on_a_narrow_page_nothing_is_cut_off(page):
    page.size(390, 800, mobile=True)
    page.run("new Promise(requestAnimationFrame)")
    assert page.run("document.documentElement.scrollWidth") <= 390
    ends = "e => { const r = e.getBoundingClientRect(); return [r.left, r.right]; }"
    boxes = page.run(f"[...document.querySelectorAll('#tools > *, header > *')].map({ends})")
    assert all(0 <= left < right <= 390 for left, right in boxes)
    page.size(1280, 800)


def test_the_command_ends_with_what_was_measured(page, app):
    process, _ = app
    process.send_signal(signal.SIGTERM)
    rest, _ = process.communicate(timeout=30)
    assert process.returncode == 0
    assert rest.count("two.ply") == 2
    page.wait("!document.getElementById('lost').hidden", seconds=20)
    page.said[:] = [
        one for one in page.said if "net::ERR_" not in one
    ]  # how a refused request is called depends on when
