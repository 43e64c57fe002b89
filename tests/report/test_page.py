"""Pages need nothing but themselves, and nothing a user typed becomes markup."""

import re

import numpy as np
import pytest

from cablejax.report import Page, data_uri, figure_style, png_bytes, point_scene, point_views, thin


def clouds() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    xyz = np.stack([np.linspace(0, 100, 50), np.cos(np.arange(50.0)), np.sin(np.arange(50.0))], axis=1)
    value = np.where(np.arange(50) % 10 == 0, np.nan, np.sin(np.arange(50.0)))
    return {"raw": (xyz, value), "filtered": (xyz, 0.1 * value)}


def test_a_page_refers_to_nothing_outside_itself():
    page = Page("A title")
    page.section("Scene")
    page.scene(point_scene(clouds(), label="deviation (mm)", limit=1.0), caption="Points.")
    with figure_style():
        page.figure(point_views(clouds(), label="deviation (mm)", limit=1.0), alt="points", caption="Points.")
    text = page.render()
    assert not re.search(r"<(script|img|link)[^>]+(src|href)=[\"'](?!data:)", text)
    assert "Plotly" in text
    assert "data:image/png;base64," in text


def test_outside_is_red_and_inside_blue_in_every_picture():
    from cablejax.report import scene_figure

    trace = scene_figure(clouds(), label="deviation (mm)", limit=1.0).data[0]
    inside, outside = (np.array(re.findall(r"\d+", trace.marker.colorscale[end][1]), int) for end in (0, -1))
    dots = point_views(clouds(), label="deviation (mm)", limit=1.0).axes[0].collections[0]
    low, high = dots.to_rgba([-1.0, 1.0])[:, :3]
    for blue, red in ((inside, outside), (low, high)):
        assert blue[2] > blue[0]
        assert red[0] > red[2]


def test_what_is_given_is_escaped():
    page = Page("<script>alert(1)</script>", subtitle="<b>")
    page.section("<i>", "<u>")
    page.note("<em>")
    page.table(["<h>"], [["<c>"]], caption="<cap>")
    text = page.render()
    for raw in ("<script>alert", "<i>", "<u>", "<em>", "<c>", "<cap>", "<h>", "<b>"):
        assert raw not in text


def test_backticks_set_code_in_pairs():
    page = Page("t")
    page.text("`a < b` of one, and a ` alone")
    page.note("run `cablejax measure`, <b> `x & y`")
    rendered = page.render()
    assert "<p>`a &lt; b` of one, and a ` alone</p>" in rendered
    assert "run <code>cablejax measure</code>, &lt;b&gt; <code>x &amp; y</code>" in rendered


def test_rows_must_fit_the_header():
    with pytest.raises(ValueError, match=r"rows: expected 2 cells as in the header, got 1"):
        Page("t").table(["a", "b"], [["1"]], caption="")


def test_the_same_figure_gives_the_same_bytes():
    with figure_style():
        first, second = (png_bytes(point_views(clouds(), label="d", limit=1.0)) for _ in range(2))
    assert first == second
    assert data_uri(first).startswith("data:image/png;base64,iVBOR")


@pytest.mark.parametrize(("n", "most"), [(0, 5), (3, 5), (5, 5), (1000, 7)])
def test_thinning_keeps_at_most_so_many_and_both_ends(n: int, most: int):
    rows = thin(n, most=most)
    assert len(rows) == min(n, most)
    assert n == 0 or (rows[0], rows[-1]) == (0, n - 1)
