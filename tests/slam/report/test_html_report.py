import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from slam.errors import OutputError
from slam.report.formatting import MISSING
from slam.report.html_report import write_report

from . import fabricate

WHOLE = fabricate.record()
DATA = {"type": "application/json"}  # not run by browsers
VOID = {"meta", "input", "br", "img", "link", "hr"}


class Page(HTMLParser):
    """Checks nesting, and collects tags with their attributes and the words outside scripts and styles."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.words = [], [], []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("script", "style"):
            self.words.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())

    def ids(self):
        return [attrs["id"] for _, attrs in self.tags if "id" in attrs]


def written(record, tmp_path, **more):
    write_report(record, tmp_path / "report.html", **more)
    return (tmp_path / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return written(WHOLE, tmp_path_factory.mktemp("report"))


def test_the_page_is_well_formed_and_its_ids_are_unique(whole):
    ids = Page(whole).ids()
    assert len(ids) == len(set(ids))


def test_the_page_loads_nothing(whole):
    assert "http" not in re.sub(r"http-equiv", "", whole)
    sources = [attrs.get("src") or attrs.get("xlink:href") or "" for _, attrs in Page(whole).tags]
    assert all(source.startswith(("data:", "#")) for source in sources if source)


def test_the_page_is_the_same_each_time(whole, tmp_path):
    assert written(fabricate.record(), tmp_path) == whole


@pytest.mark.parametrize("name", ['</script><script>alert("1")</script>', "a'\"<b>&amp;", "улица 街道", "{{ 7 * 7 }}"])
def test_a_hostile_name_is_shown_as_text(name, tmp_path):
    rows = tuple(replace(row, reason=name) for row in WHOLE.loops)
    metrics = {**WHOLE.metrics, "source": name, "notes": {name: name, "odometry": name}}
    stages = {name: WHOLE.stage_ms["read"]}
    hostile = replace(WHOLE, name=name, loops=rows, metrics=metrics, stage_ms=stages)
    page = Page(written(hostile, tmp_path, config={name: {name: name}}))
    assert page.text.count(" ".join(name.split())) > len(rows)
    assert [attrs for tag, attrs in page.tags if tag == "script"] == [*[DATA] * 3, {**DATA, "id": "loop-details"}, {}]
    assert not any(tag == "b" and attrs for tag, attrs in page.tags)


def test_the_loop_log_has_one_row_for_each_of_the_record(whole):
    assert sum("data-outcome" in attrs for _, attrs in Page(whole).tags) == len(WHOLE.loops)


def test_what_is_not_known_is_a_dash_with_its_reason(whole):
    cells = re.findall(rf'<abbr title="the drive is shorter than 800 m">{MISSING}</abbr>', whole)
    assert len(cells) == 1
    assert "odometry.t_rel_percent : the drive is shorter than 800 m" in Page(whole).text


def test_each_stage_has_its_time_and_what_it_holds(whole):
    assert re.search(r"odometry \d+\.\d \d+\.\d \d+ % 3\.2 recognise", Page(whole).text)
    assert re.search(rf"verify \d+\.\d \d+\.\d \d+ % {MISSING} \(not computed\)", Page(whole).text)


def test_table_headings_have_a_scope_and_tables_a_caption(whole):
    tags = Page(whole).tags
    assert all("scope" in attrs for tag, attrs in tags if tag == "th")
    assert sum(tag == "caption" for tag, _ in tags) == sum(tag == "table" for tag, _ in tags)


def test_drawings_say_what_they_show(whole):
    drawings = [attrs for tag, attrs in Page(whole).tags if tag == "svg"]
    assert len(drawings) == 6
    assert all(attrs["role"] == "img" and attrs["aria-label"] for attrs in drawings)


@pytest.mark.parametrize(
    "record",
    [
        fabricate.without_truth(WHOLE),
        fabricate.without_loops(WHOLE),
        fabricate.straight(),
        fabricate.standing(),
    ],
)
def test_every_drive_has_a_report(record, tmp_path):
    assert Page(written(record, tmp_path)).text.startswith(record.name)


def test_a_record_without_any_metrics_has_a_report(tmp_path):
    assert "not computed" in written(replace(WHOLE, metrics={}), tmp_path)


def test_closed_loops_are_shown_with_their_images(tmp_path):
    grey = np.full((100, 200), 127, np.uint8)
    page = Page(written(WHOLE, tmp_path, images=lambda index: grey))
    assert sum(tag == "img" for tag, _ in page.tags) == 6


def test_images_that_are_not_at_hand_are_left_out(tmp_path):
    assert not any(tag == "img" for tag, _ in Page(written(WHOLE, tmp_path, images=lambda index: None)).tags)


def test_the_configuration_is_listed_by_dotted_names(tmp_path):
    page = Page(written(WHOLE, tmp_path, config={"verifier": {"min_inliers": 25}}))
    assert "verifier.min_inliers 25" in page.text


def test_a_report_that_cannot_be_written_names_the_file(tmp_path):
    with pytest.raises(OutputError, match=r"nowhere/r\.html: cannot write the report"):
        write_report(WHOLE, tmp_path / "nowhere" / "r.html")


def test_the_stages_of_place_recognition_are_pictures(tmp_path):
    page = Page(written(fabricate.with_evidence(WHOLE), tmp_path)).text
    for words in ("Precision over recall", "own score: R@P100", "Candidates", "Reliability", "calibration error"):
        assert words in page
    without = Page(written(replace(fabricate.with_evidence(WHOLE), place_stages=None, reliability=None), tmp_path)).text
    assert "all thresholds: R@P100" in without
    assert "calibration error" not in without
