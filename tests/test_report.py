"""``--report``: one page of results, figures and configuration, which needs nothing beside it."""

import html.parser
import json
import re
import shutil
import subprocess

import numpy as np
import pytest

from gearjax.cli import main
from gearjax.plot import figures_kept, new_figure, report_page, save_figure
from tests.conftest import CONFIG

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")


class Page(html.parser.HTMLParser):
    """Tags of a page, its text, and every address that it would fetch."""

    def __init__(self, text: str):
        super().__init__()
        self.tags, self.addresses, self.words = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.addresses += [value for name, value in attrs if name in ("src", "href", "xlink:href") and value]

    def handle_data(self, data):
        self.words.append(data)


def curves_of(text: str) -> list[list[dict]]:
    """What the pointer finds, of each figure and its axes."""
    found = re.findall(r'<script type="application/json">(.*?)</script>', text, flags=re.DOTALL)
    return [json.loads(data) for data in found]


def test_a_page_has_what_it_is_given():
    figure, (ax,) = new_figure()
    x = np.linspace(0.0, 1.0, 90_001)
    ax.plot(x, np.sin(x), label="a curve")
    ax.axvline(0.5)
    ax.set(xlabel="time [s]", ylabel="force [N]")
    told = {"cases": [{"mean": 1.25, "at": None}, {"mean": 2.5, "words": "<b>"}], "many": list(range(40)), "ok": True}
    text = report_page("a <title>", told, {"one.png": figure}, 'kind = "two_kv"  # <script>', ["beware of <this>"])
    page, words = Page(text), " ".join(Page(text).words)
    assert all(address.startswith(("#", "data:")) for address in page.addresses)
    for shown in ("a <title>", "1.25", "2.5", "<b>", "40 in all", "yes", "# <script>", "beware of <this>", "jaxlib"):
        assert shown in words, shown
    ((axes,),) = curves_of(text)
    assert (axes["x"][3], axes["y"][3]) == ("time [s]", "force [N]")
    (curve,) = axes["curves"]  # not the mark
    assert curve["label"] == "a curve"
    assert 10_000 < len(curve["x"]) <= 20_000
    np.testing.assert_allclose(curve["y"], np.sin(curve["x"]), atol=1e-5)
    assert len(text) < 2_000_000, "so many points are drawn as an image"
    left, top, right, bottom = axes["box"]
    assert 0 < left < right < 1
    assert 0 < top < bottom < 1


def test_figures_are_kept_while_asked_for(tmp_path):
    with figures_kept() as kept:
        save_figure(new_figure()[0], tmp_path / "one.png")
        save_figure(new_figure()[0], tmp_path / "two.svg")
    save_figure(new_figure()[0], tmp_path / "three.pdf")
    assert list(kept) == ["one.png", "two.svg"]
    assert (tmp_path / "one.png").read_bytes().startswith(b"\x89PNG")
    assert b"<svg" in (tmp_path / "two.svg").read_bytes()
    assert (tmp_path / "three.pdf").read_bytes().startswith(b"%PDF")


def test_a_page_needs_a_folder(capsys):
    for command in ("run", "optimise", "tolerance", "identify"):
        file = {"run": CONFIG, "identify": CONFIG.with_name("measured.toml")}.get(
            command, CONFIG.with_name(f"wang_2020_{'phases' if command == 'optimise' else 'tolerance'}.toml")
        )
        with pytest.raises(SystemExit, match="2"):
            main([command, str(file), "--json", "--report"])
        assert "needs a folder: give --out DIR" in capsys.readouterr().err


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The page of a run, and what the command printed."""
    folder = tmp_path_factory.mktemp("report")
    text = CONFIG.read_text(encoding="utf-8").replace("samples = 3001", "samples = 301")
    (folder / "mine.toml").write_text(text, encoding="utf-8")
    with pytest.raises(SystemExit, match="0"):
        main(["run", str(folder / "mine.toml"), "--out", str(folder), "--report"])
    return folder


@pytest.mark.slow
def test_a_run_writes_its_page(written):
    text = (written / "report.html").read_text(encoding="utf-8")
    page, words = Page(text), " ".join(Page(text).words)
    drawn = len(list(written.glob("*.png")))
    assert page.tags.count("svg") == len(curves_of(text)) == drawn > 1
    assert not [address for address in page.addresses if not address.startswith(("#", "data:"))]
    assert "peak to peak arcmin" in words
    assert 'kind = "two_kv"' in words
    assert len(text) < 10_000_000


@pytest.mark.slow
def test_a_browser_shows_it_without_an_error(written, tmp_path):
    """Values appear under the pointer; the console stays empty."""
    browser = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if browser is None:
        pytest.skip("no browser here")
    text = (written / "report.html").read_text(encoding="utf-8")
    look = """<script>
    for (const svg of document.querySelectorAll("figure svg")) {  // drawings without curves too
        svg.dispatchEvent(new MouseEvent("mousemove", {clientX: 9, clientY: 9}));
    }
    const read = figure => JSON.parse(figure.querySelector("script")?.textContent ?? "[]");
    const curves = [...document.querySelectorAll("figure")].find(figure => read(figure).length);
    const svg = curves.querySelector("svg"), frame = svg.getBoundingClientRect();
    const {box} = read(curves)[0];
    const at = [(box[0] + box[2]) / 2 * frame.width, (box[1] + box[3]) / 2 * frame.height];
    svg.dispatchEvent(new MouseEvent("mousemove", {clientX: frame.left + at[0], clientY: frame.top + at[1]}));
    document.title = "shown: " + curves.querySelector(".tip").textContent + " of " + frame.width;
    </script></body>"""
    (tmp_path / "page.html").write_text(text.replace("</body>", look), encoding="utf-8")
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--dump-dom"]
    shown = subprocess.run(
        [browser, *options, (tmp_path / "page.html").as_uri()], capture_output=True, text=True, timeout=120, check=True
    )
    assert "CONSOLE" not in shown.stderr, shown.stderr
    title = re.search(r"<title>(.*?)</title>", shown.stdout)
    assert title
    assert re.match(r"shown: .*time \[s\]: [\d.e-]+ .*\[arcmin\]: -?[\d.]+ of [1-9]\d\d", title[1]), title[1]


@pytest.mark.slow
def test_show_opens_the_report_or_the_figures(written, tmp_path, monkeypatch, capsys):
    opened = []
    monkeypatch.setattr("typer.launch", opened.append)
    monkeypatch.setattr("gearjax.cli.show._has_display", lambda: True)
    with pytest.raises(SystemExit, match="0"):
        main(["show", str(written)])
    assert opened == [str(written / "report.html")] == capsys.readouterr().out.split()
    (tmp_path / "b.png").touch()
    (tmp_path / "a.svg").touch()
    (tmp_path / "c.csv").touch()
    monkeypatch.setattr("gearjax.cli.show._has_display", lambda: False)
    with pytest.raises(SystemExit, match="0"):
        main(["show", str(tmp_path)])
    told = capsys.readouterr()
    assert told.out.split() == [str(tmp_path / "a.svg"), str(tmp_path / "b.png")]
    assert "no display here" in told.err
    assert len(opened) == 1


def test_show_refuses_what_has_no_figures(tmp_path, capsys):
    for folder, words in (
        (tmp_path, "has no figures"),
        (tmp_path / "none", "is not a folder"),
        (CONFIG, "is not a folder"),
    ):
        with pytest.raises(SystemExit, match="2"):
            main(["show", str(folder)])
        told = capsys.readouterr().err
        assert words in told
        assert told.count("\n") == 1
