"""Would catch a report that loads from elsewhere, does not escape, contradicts the results or fails a browser."""

import base64
import csv
import hashlib
import re
import shutil
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path
from urllib.parse import unquote

import netCDF4
import numpy as np
import pytest

from compasslib import angles, report
from compasslib.archive import calibrations
from compasslib.archive.files import read_json, write_json
from compasslib.calibrations import calibrate, platform, result, two_heads
from compasslib.config.cruise import load_cruise
from compasslib.effects import SIDES
from compasslib.errors import InputError
from compasslib.inference.diagnosis import Diagnosis
from compasslib.inference.finding import CovariateRange, HeldOut, Parameter, Unexplained
from compasslib.inference.finding import Finding as Found
from compasslib.plots.figures import MOORING
from compasslib.report import explore, sections, words
from compasslib.report.sections import (
    Overview,
    ReportedFinding,
    ReportFigure,
    ReportSection,
    ReportTable,
    embed,
    error_removed,
    read_mooring,
    stopped_section,
)
from compasslib.stages import settings
from tests.world import browser, iaga_files, iron, page
from tests.world.bench import readings, ring, write_calibration
from tests.world.launch import change, completed
from tests.world.package import Sea
from tests.world.sea import cruise
from tests.world.two_heads_files import cast

HOSTILE = """<script>document.title = 'broken'</script><img src=x onerror="document.title='broken'"> & "quoted" 'so'"""
ALONE = ("ALONE." + "".join(f"WM{k}Q" for k in range(20)))[:64]  # as long and about as wide as a name may be
OUTSIDE = r"(?:src|href|action|poster|srcset)\s*=\s*[\"']?\s*(?:https?:)?//|url\(|@import"


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Process a mooring, one without a reference instrument and two calibrations, with markup in attributes."""
    folder = cruise(tmp_path_factory.mktemp("cruise"), ("M1",), n=600)
    shutil.copy(folder / "config/moorings/M1.yaml", folder / "config/moorings/A.yaml")
    change(folder / "config/moorings/A.yaml", name=ALONE, reference=None)
    change(folder / "config/moorings/M1.yaml", attributes={"instrument": HOSTILE, "serial_number": "<b>1</b>"})
    change(folder / "config/config.yaml", attributes={"project": HOSTILE, "institution": "Fjord & Søn <i>"})
    write_calibration(folder, "bench", readings(), budget="le_menn")
    write_calibration(folder, "few", readings(ring(3)), latitude=None, longitude=None)
    return completed(folder)


@pytest.fixture(scope="module")
def document(done):
    return page.read(done / "results/report.html")


def filled(kind, text: str):
    """Return a part of the report with this text in every text field."""
    by_type = {
        "str": text,
        "tuple[str, ...]": (text, text),
        "tuple[tuple[str, str], ...]": ((text, text), (text, "x")),
        "tuple[tuple[str, ...], ...]": ((text, text), ("", text)),
    }
    several = [f"tuple[{part}, ...]" for part in ("ReportedFinding", "ReportTable", "ReportFigure")]
    parts = ("int", "bool", "ReportTable | None", *several)
    return kind(**{one.name: by_type[one.type] for one in fields(kind) if one.type not in parts})


def hostile(name: str = "M") -> ReportSection:
    parameters = filled(ReportTable, HOSTILE)
    figure = replace(filled(ReportFigure, HOSTILE), data="", href="M/figures/x.png")
    return replace(
        filled(ReportSection, HOSTILE),
        name=name,
        anchor=f"mooring-{name}",
        verdict="consistent",
        findings=(replace(filled(ReportedFinding, HOSTILE), parameters=parameters),),
        tables=(parameters,),
        use="with care",
        picture=(("recorded", HOSTILE),),
        figures=(figure, replace(figure, data="data:image/png;base64,", width=3, height=5)),
    )


def written(path: Path, sections) -> page.Document:
    overview, empty = Overview(HOSTILE, ("Name", *"abcdefghi"), sections), Overview("")
    made = report.Report(HOSTILE, ((HOSTILE, HOSTILE),), overview, empty, empty, HOSTILE, HOSTILE)
    report.write(path, made)
    return page.read(path)


def test_every_text_is_escaped(tmp_path):
    """With markup in every text of every part, the page has no script and shows the text verbatim."""
    made = written(tmp_path / "r.html", [hostile()])
    assert not made.all("script") and not [one for one in made.all("img") if "onerror" in one.attributes]
    assert not [one for one in made.elements if any(name.startswith("on") for name in one.attributes)]
    named = ("p", "dt", "dd", "li", "td", "th", "summary", "h1", "h5", "figcaption", "title", "text")
    said = sum(one.text.count(HOSTILE) for one in made.all(*named))
    assert said > 30
    assert HOSTILE not in (tmp_path / "r.html").read_text()
    assert all(one.attributes["alt"].startswith(HOSTILE) for one in made.all("img"))


def test_attributes_names_and_warnings_of_a_cruise_are_escaped(done, document):
    text = (done / "results/report.html").read_text()
    assert not document.all("script") and "<b>1" not in text and "Søn <i>" not in text
    assert HOSTILE in document.all("h1")[0].text
    assert any("<b>1</b>" in one.text for one in document.all("td"))


def test_page_loads_nothing_external(done, document):
    text = (done / "results/report.html").read_text()
    assert not re.search(OUTSIDE, re.sub(r"data:image/png;base64,[A-Za-z0-9+/=]*", "", text))
    assert not document.all("script", "iframe", "object", "embed", "audio", "video", "base", "form")
    assert not [one for one in document.elements if "style" in one.attributes]
    policy = next(one for one in document.all("meta") if "http-equiv" in one.attributes).attributes["content"]
    style = re.search("<style>(.*?)</style>", text, re.DOTALL).group(1)
    known = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode()
    assert policy.startswith("default-src 'none'") and f"style-src 'sha256-{known}'" in policy
    assert "unsafe" not in policy and "script-src" not in policy


def test_every_link_has_a_target(done, document):
    ids = {one.attributes.get("id") for one in document.elements}
    links = [one.attributes["href"] for one in document.all("a")]
    assert len(links) > 40
    for link in links:
        there = link[1:] in ids if link.startswith("#") else (done / "results" / unquote(link)).exists()
        assert there, link


def test_headings_are_nested_and_landmarks_unique(document):
    levels = [int(one.name[1]) for one in document.all("h1", "h2", "h3", "h4", "h5", "h6")]
    assert levels[0] == 1 and levels.count(1) == 1
    assert all(below - above <= 1 for above, below in pairwise(levels))
    named = [one.attributes["aria-labelledby"] for one in document.all("section")]
    ids = [one.attributes["id"] for one in document.elements if "id" in one.attributes]
    assert len(named) == len(set(named)) > 3 and len(ids) == len(set(ids))
    assert len(document.all("table")) == len(document.all("caption")) > 5


def test_every_figure_has_an_alternative_text_and_a_caption(done, document):
    pictures = document.all("img")
    drawn = list((done / "results").rglob("figures/*.png"))
    of_pairs = sum(row.of_pairs for row in MOORING)  # ALONE has no pairs
    assert len(drawn) == 2 * 10 + 5 + 2 * 2 and len(pictures) == len(drawn) - of_pairs
    assert len({one.attributes["alt"] for one in pictures}) == len(pictures) <= len(document.all("figcaption"))


def test_page_begins_with_one_sentence_per_result(done, document):
    """One sentence per mooring and calibration with its numbers; a mooring begins with advice and its currents."""
    overview = [one.text for one in document.all("th") if one.attributes["scope"] == "row"][:4]
    assert overview == [ALONE, "M1", "bench", "few"]
    diagnosis, assessment = (read_json(done / f"results/M1/{x}.json") for x in ("diagnosis", "assessment"))
    chance = words.chance(diagnosis["sides"]["none"] + diagnosis["sides"]["water"])
    results = read_mooring("M1", done / "results", {})
    assert f"probability {chance}" in " ".join(sections.summary_sentences(results))
    with netCDF4.Dataset(done / "results/M1/corrected.nc") as nc:
        sigma = float(np.nanmedian(nc["HEADING_CORRECTED_UNCERTAINTY"][:].filled(np.nan)))
    answer = assessment["use"]["answer"]
    assert answer == ("yes" if sigma <= 5.0 else "with care")
    said = [one.text for one in document.all("p") if one.attributes.get("class") == "answer"]
    assert "No. No heading is corrected: no overlapping pairs" in said[0]
    digits = 2 if "exceeds" in assessment["use"]["why"] else 1
    assert f"{answer.capitalize()}, with an uncertainty of {sigma:.{digits}f}° (1σ, median)" in said[1]


def test_absent_deviation_is_stated_without_a_deviation_value(done):
    results = read_mooring("M1", done / "results", {"warnings": ""})
    assert "the compass deviated by up to" in " ".join(sections.summary_sentences(results))
    without = results.fit | {"applied": results.fit["applied"] | {"no_deviation_probability": 0.8}}
    said = " ".join(sections.summary_sentences(replace(results, fit=without)))
    assert "No deviation is shown; headings are left as recorded" in said and "deviated" not in said


def test_numbers_agree_with_the_results(done, document):
    rows = {row["name"]: row for row in csv.DictReader((done / "results/summary.csv").read_text().splitlines())}
    shown = [one.text for one in document.all("td", "th")]
    at = shown.index("M1") + 2  # after the picture
    results = read_mooring("M1", done / "results", rows["M1"])
    removed = words.with_sigma(*results.headings["removed_deg"], "°")
    assert [text.strip() for text in shown[at : at + 4]] == [
        *(rows["M1"]["use"], f"{results.headings['sigma_deg'][0]:.1f}°", removed, rows["M1"]["verdict"])
    ]
    assert shown[at + 5 : at + 7] == [f"{float(rows['M1'][f'rms_{when}_deg']):.1f}°" for when in ("before", "after")]
    alone = [text.strip() for text in shown[shown.index(ALONE) + 2 :]]
    assert alone[:4] == ["no", words.UNKNOWN, words.UNKNOWN, "insufficient"] and alone[5] == words.UNKNOWN
    text = " ".join(one.text for one in document.all("p", "li"))
    assert rows[ALONE]["warnings"].split(" | ")[0][1:40] in text


def diagnosis(verdict: str, *findings: Found, **more) -> dict:
    """Return the content of diagnosis.json as the search writes it."""
    return Diagnosis(verdict, findings, not_testable=(("stuck_tilt", "no other sensor"),), **more).to_json()


def heeling(*alternatives: str) -> Found:
    where = CovariateRange("pitch", 4.0, 11.0, "along pitch from 4 to 11 degrees")
    proof = HeldOut(11.9, 11.3, 40.0, (20.0, 60.0), 0.000999)
    parameters = {"b_z_nT": Parameter(2100.4, 140.0, "nT")}
    when_s = (1188864000.0, 1223078400.0)
    return Found("heeling", "compass", alternatives, where, when_s, parameters, 3.14, proof, "It heels.", applied=True)


def test_finding_is_reported_with_its_alternatives_shortened_and_its_proof():
    names = ["tilt_uncompensated", "temperature", "pressure", "hard_iron_step", "hard_iron_drift", "compass_drift"]
    for more, last in (([], "(compass drift)"), (["compass_lag"], "2 others, listed in diagnosis.json")):
        (told,) = sections.report_findings(diagnosis("ambiguous", heeling(*names, *more)), product=True)
        facts = {name: value.replace(words.SPACE, " ") for name, value in told.facts}
        listed = facts["Alternatives"].split("; ")
        assert len(listed) == 6 and listed[-1].endswith(last)
    assert (told.title, told.text, facts["Acts on"]) == ("Heeling", "It heels.", "compass")
    assert facts["When"] == "4 Sep 2007 to 4 Oct 2008" and facts["Corrected in the product"] == "yes"
    assert facts["Residual on held-out days"] == "11.90° before, 11.30° after rms (p ≤ 0.001)"
    assert [cell.replace(words.SPACE, " ") for cell in told.parameters.rows[0]] == ["field down", "2100 ± 140 nT"]


def test_unexplained_mismatch_and_decisive_observations_are_reported():
    where = CovariateRange("speed", 0.1, 0.4, "along speed from 0.1 to 0.4 m/s")
    left = Unexplained(("speed",), where, (1188864000.0, 1223078400.0), 2.0, (), "Nothing fits.")
    told = diagnosis("unexplained", heeling(), unexplained=left, separated_by="a swing; wider headings")
    *_, last = sections.report_findings(told, product=True)
    assert (last.title, last.text) == ("Unexplained", "Nothing fits.") and ("Size", "2.0° rms") in last.facts
    assert sections.describe_limits(told)[:3] == (
        "Decisive observation: A swing.",
        "Decisive observation: Wider headings.",
        "Not testable in this record: stuck tilt (no other sensor).",
    )
    assert "an unexplained mismatch of 2.0° rms" in sections.describe_findings(told).replace(words.SPACE, " ")


def test_every_effect_is_described_with_its_name_in_brackets():
    for effect in SIDES:
        (clause,) = sections.candidate_names({"effect": effect, "alternatives": []})
        begun, name = clause.rstrip(")").split(" (")
        assert name == words.plain(effect) and len(begun.split()) > 2 and begun != name
    composed = {"acts_on": "field_down", "driver": "tilt", "form": "smooth"}
    several = {"effect": "composed", "alternatives": ["pressure"], "composition": composed, "probability": 0.6}
    first, second = sections.candidate_names(several | {"alternatives_probability": {"pressure": 0.35}})
    assert "along a smooth curve of the tilt" in first and f"probability 60{words.SPACE}%" in first
    assert f"(pressure, probability 35{words.SPACE}%)" in second


def made_of(kind: str, folder: Path) -> result.Calibration:
    """Run a calibration of a kind on a small simulated log."""
    rng, course = np.random.default_rng(1), np.arange(0.0, 360.0, 10.0)
    if kind == "magnetometer":
        x, y, z = iron.readings(rng, iron.some(rng), iron.tumble(rng, 600)).T
        log = iron.write(folder / "log.csv", x=x, y=y, z=z)
        return calibrate(kind, [log], {"latitude": 48.4, "longitude": -4.5, "date_s": 1664409600.0})
    if kind == "declination":
        return calibrate(kind, [iaga_files.write(folder / "a.hor", iaga_files.series(30))], {"declination": "auto"})
    columns, settings = {
        "swing": (
            {"compass_deg": course, "cog_deg": course + rng.normal(0.0, 1.0, 36), "speed_kn": 0.0 * course + 6.0},
            {"declination": 2.0},
        ),
        "tilt": (dict.fromkeys(platform.TILT_ROLES, np.r_[-20.0:20.1:1.0]), {}),
    }[kind]
    np.savetxt(
        folder / "log.csv", np.column_stack(list(columns.values())), "%.3f", ",", header=",".join(columns), comments=""
    )
    return calibrate(kind, [folder / "log.csv"], settings)


def section_of(kind: str, made: result.Calibration, folder: Path, diagnosed: dict | None = None) -> ReportSection:
    there = folder / f"calibrations/{kind}"
    files = {"calibration": there / "calibration.json", "table": there / "table.csv", "points": there / "points.csv"}
    calibrations.write(page=result.to_json(kind, made, {}), made=made, **files)
    write_json(there / "diagnosis.json", diagnosed or diagnosis("consistent"))
    (section,) = report.gather(folder, attributes={}, moorings={}, calibrations=[kind]).calibrations.sections
    return section


@pytest.mark.parametrize("kind", ["magnetometer", "declination", "swing", "tilt"])
def test_every_kind_of_calibration_has_its_section(tmp_path, kind):
    made = made_of(kind, tmp_path)
    assert made.why == "" and section_of(kind, made, tmp_path).summary


def test_two_heads_with_a_diagnosis_have_their_section(tmp_path):
    """A kind with its own texts, together with a diagnosis."""
    made = two_heads.calibrate(cast(tmp_path, sea=Sea(turns=0.0, wander_deg=14.0)), {})
    section = section_of("heads", made, tmp_path, diagnosis("explained", heeling()))
    assert section.verdict == "explained" and section.findings[0].title == "Heeling"
    assert set(made.details["cannot_tell"]) < set(section.limits)
    assert made.details["frame"]["text"].rstrip(".") in " ".join(section.summary)
    assert any("Offset of the second" in fact for fact in section.facts)
    assert section.cells[-2] == "explained" and "Corrected in the product" not in dict(section.findings[0].facts)


def test_large_fleet_has_links_to_its_figures(done, tmp_path, monkeypatch):
    """No figure is embedded, each is linked; each mooring adds less than 20 kB."""
    monkeypatch.setattr(report, "MAX_SECTIONS", 3)
    described = settings.report(load_cruise(done))["moorings"]
    one = report.gather(done / "results", attributes={}, moorings=described, calibrations=["few"] * 3)
    section = next(section for section in one.moorings.sections if section.name == "M1")
    assert len(section.figures) == 10
    assert all(not figure.data and (done / "results" / figure.href).exists() for figure in section.figures)
    _, many = (written(tmp_path / f"{n}.html", [replace(section, anchor=f"m{k}") for k in range(n)]) for n in (1, 21))
    assert len(many.all("details")) == 21
    assert (tmp_path / "21.html").stat().st_size - (tmp_path / "1.html").stat().st_size < 20 * 20_000


def test_stopped_mooring_is_listed_among_the_results(tmp_path):
    made = written(
        tmp_path / "r.html", [stopped_section("mooring", "M", "raw/top.000: expected a PD0 file", ("", "Verdict"))]
    )
    assert "M: No. There are no results" in " ".join(made.all("li")[0].text.split())
    assert {"stopped", "no"} <= {one.text for one in made.all("span")}


def test_damaged_figure_is_reported_in_one_line(done, tmp_path):
    folder = tmp_path / "M1/figures"
    folder.mkdir(parents=True)
    whole = (done / "results/M1/figures/scatter.png").read_bytes()
    (folder / "scatter.png").write_bytes(whole[: len(whole) // 2])
    figure = ReportFigure("Scatter", "", "M1/figures/scatter.png")
    with pytest.raises(InputError, match=r"scatter.png: expected a whole PNG, found .*; run the cruise again"):
        embed([figure], tmp_path)


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        (words.percent(1.0), "100.0 %"),
        (words.percent(0.99999), ">99.9 %"),
        (words.degrees(-0.25, 2), "−0.25°"),
        (words.number(-7.2e136), "−7.2e+136"),
        (words.with_sigma(2100.4, 140.0, "nT"), "2100 ± 140 nT"),
        (words.with_sigma(3.39, 3.93, "degrees"), "3.4 ± 3.9°"),
        (words.chance(0.999), ">99 %"),
        (words.current(0.03 - 0.04j), "5.0 cm/s towards 143°"),
        (words.current(complex("nan")), "–"),
        (words.count(9504), "9 504"),
        (angles.position(-8.9, 219.9), "8.9000° S, 140.1000° W"),
        (words.days({"from": "2003-10-29T06:10:00Z", "to": "2003-10-29T23:00:00Z"}), "29 Oct 2003, 06:10 to 23:00 UTC"),
    ],
)
def test_numbers_and_words_are_formatted(said, expected):
    assert said.replace(words.SPACE, " ") == expected


# In a real browser.

needs_browser = pytest.mark.skipif(browser.program() is None, reason="no Chromium here (Debian's package chromium)")


@pytest.fixture(scope="module")
def chromium(tmp_path_factory):
    with browser.chromium(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@needs_browser
@pytest.mark.parametrize(("width", "scheme"), [(360, "light"), (1400, "dark")])
def test_page_loads_alone_and_fits_the_window(done, chromium, width, scheme):
    path = done / "results/report.html"
    chromium.open(path, width, scheme=scheme)
    asked = [event["request"]["url"] for event in chromium.happened("Network.requestWillBeSent")]
    assert [url for url in asked if not url.startswith("data:")] == [path.resolve().as_uri()]
    assert not chromium.happened("Runtime.exceptionThrown") and not chromium.happened("Log.entryAdded")
    assert chromium.ask("document.title").startswith("Compass deviations corrected: <script>")
    assert chromium.ask("document.documentElement.scrollWidth") == width
    assert chromium.ask("[...document.images].every(i => i.complete && i.naturalWidth > 300 && i.alt.length > 20)")
    dark = chromium.ask("getComputedStyle(document.body).backgroundColor") != "rgb(255, 255, 255)"
    assert dark is (scheme == "dark")
    assert chromium.ask("getComputedStyle(document.images[0]).backgroundColor") == "rgb(255, 255, 255)"


@needs_browser
def test_keyboard_reaches_the_results_with_visible_focus(done, chromium):
    chromium.open(done / "results/report.html", 1400)
    chromium.press("Tab")
    assert chromium.ask("document.activeElement.innerText") == "Skip to the results"
    assert chromium.ask("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    chromium.press("Enter")
    assert chromium.ask("document.activeElement.id") == "main"
    for _ in range(2):  # the table of all moorings, its first link
        chromium.press("Tab")
    chromium.press("Enter")
    assert chromium.ask("location.hash") == f"#mooring-{ALONE}"
    assert chromium.ask("document.querySelector('details').open")  # its link opens a fold


# The series to look at.

DRAWN = "new Promise(ok => { const wait = () => document.body.dataset.drawn ? ok() : setTimeout(wait, 20); wait(); })"


@pytest.fixture
def series(done, chromium):
    """Open the page of the series at a width, and wait until it has drawn M1."""

    def opened(width: int) -> browser.Page:
        chromium.open(done / "results/explore.html", width)
        chromium.ask(f"{DRAWN}.then(() => choose('M1'))")
        return chromium

    return opened


@needs_browser
@pytest.mark.parametrize("width", (390, 1400))
def test_series_are_drawn_without_a_network_or_an_error(done, series, width):
    page_ = series(width)
    asked = [event["request"]["url"] for event in page_.happened("Network.requestWillBeSent")]
    assert [url for url in asked if not url.startswith("data:")] == [(done / "results/explore.html").as_uri()]
    assert not page_.happened("Runtime.exceptionThrown") and not page_.happened("Log.entryAdded")
    assert not page_.happened("Runtime.consoleAPICalled")
    assert page_.ask("document.documentElement.scrollWidth") == width
    titles = page_.ask("[...document.querySelectorAll('figcaption')].map(e => e.textContent.split(' ')[0])")
    assert titles[:3] == ["Heading", "Direction", "Speed"] and titles[-1] == "Flag"
    painted = "c => { const d = c.ctx.getImageData(0, 0, c.ctx.canvas.width, c.ctx.canvas.height).data;"
    assert page_.ask(f"charts.every({painted} return d.some((v, k) => k % 4 === 3 && v > 0); }})")
    page_.ask(f"choose('{ALONE}')")  # without a reference and without a corrected heading
    assert page_.ask("charts.length") >= 5 and not page_.happened("Runtime.exceptionThrown")


@needs_browser
def test_series_are_zoomed_toggled_and_have_the_values_of_the_archive(done, series):
    page_ = series(1400)
    spans = "charts.map(c => c.scales.x.max - c.scales.x.min)"
    whole = page_.ask(spans)
    page_.ask("document.getElementById('in').click()")
    assert page_.ask(spans) == pytest.approx([whole[0] / 2.0] * len(whole))
    page_.drag("charts[1].over", 0.25, 0.75)
    assert page_.ask(spans) == pytest.approx([whole[0] / 4.0] * len(whole), rel=0.02)
    page_.ask("document.getElementById('plots').focus()")
    page_.press("Home")
    assert page_.ask(spans) == pytest.approx(whole)
    page_.press("ArrowRight")
    told = page_.ask("document.getElementById('values').textContent")
    index = page_.ask(f"current.times.indexOf(Date.parse('{told[:16]}Z') / 1000)")
    with netCDF4.Dataset(done / "results/M1/corrected.nc") as nc:
        for name, variable in (("heading recorded", "HEADING"), ("heading corrected", "HEADING_CORRECTED")):
            value = float(re.search(rf"{name} ([\d.]+)", told)[1])
            assert value == pytest.approx(float(nc[variable][index]), abs=0.1)
        flags = page_.ask("current.values.flag")
        np.testing.assert_array_equal([f for f in flags if f is not None], nc["HEADING_CORRECTED_QC"][:])
    page_.ask("document.getElementById('recorded').click()")
    assert page_.ask("charts[0].series.slice(1).map(s => s.show)")[:2] == [False, True]


def test_vendored_library_has_the_stated_hashes():
    folder = Path(report.__file__).parent / "vendor"
    stated = dict(line.split()[::-1] for line in (folder / "README.md").read_text().splitlines() if line[:4] == "    ")
    assert len(stated) == 3
    for name, known in stated.items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == known, name


def test_spans_are_the_dated_effects_and_the_doubts(tmp_path):
    dated, whole = (
        {"effect": name, "when": when}
        for name, when in (("hard_iron_step", {"from": "2014-09-24T00:00:00Z", "to": None}), ("heeling", None))
    )
    write_json(tmp_path / "diagnosis.json", {"findings": [dated, whole]})
    doubt = {"from": None, "to": "2014-08-02T00:00:00Z", "sigma_deg": 9.0, "why": "it stands still"}
    write_json(tmp_path / "deviation.json", {"applied": {"doubts": [doubt]}})
    first, second = explore.describe_spans(tmp_path)
    assert (first["text"], first["from"], first["to"]) == ("hard iron step", 1411516800.0, None)
    assert (second["kind"], second["from"], second["to"]) == ("doubt", None, 1406937600.0)


# Terms.


def test_terms_are_linked_once_a_section_with_the_definition_of_the_documentation(document):
    known = words.definitions()
    text = str(words.Links()("A <b> held out pair, another held-outer, and a pair."))
    assert text.count('href="#term-held-out"') == 1 and "&lt;b&gt;" in text and "another held-outer" in text
    assert text.count('href="#term-overlap-pair"') == 1 and f'title="{known["held out"]}"' in text
    terms = [one for one in document.all("a") if one.attributes.get("class") == "term"]
    ids = {one.attributes.get("id") for one in document.all("dt")}
    assert terms and {one.attributes["href"].removeprefix("#") for one in terms} <= ids


def test_error_removed_has_the_uncertainty_of_a_common_error():
    """A deviation known only up to one factor has the relative uncertainty of that factor."""
    deviation = np.array([10.0, -20.0, 5.0, np.nan])
    rms, sigma = error_removed(deviation, 0.1 * np.abs(deviation))
    assert rms == pytest.approx(np.sqrt(175.0)) and sigma == pytest.approx(0.1 * rms)
