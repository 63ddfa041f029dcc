"""matches.csv: one column a stage, read back to the bit, and tables of other programs besides."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from place_recognition.recognizer import Belief, StageScores
from slam.errors import DataError
from slam.io.matches import MATCH_COLUMNS, read_matches, write_matches

QUERY = 20
FINITE = st.floats(allow_nan=False, allow_infinity=False)
EARLIER = st.integers(0, QUERY - 1)
SCORES = st.builds(
    StageScores,
    st.lists(EARLIER, max_size=10).map(tuple),
    st.none() | FINITE,
    st.none() | EARLIER,
    st.none() | FINITE,
)
BELIEFS = st.builds(
    Belief,
    query=st.just(QUERY),
    match=EARLIER,
    score=FINITE,
    accepted=st.booleans(),
    inliers=st.none() | st.integers(0, 500),
    probability=st.none() | st.floats(0.0, 1.0),
    stages=SCORES,
    answered_at=st.none() | st.integers(QUERY, QUERY + 50),
)


@settings(max_examples=80, deadline=None)
@given(belief=BELIEFS)
def test_a_belief_with_all_its_stages_is_read_back(belief: Belief, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("matches") / "matches.csv"
    write_matches(path, [belief])
    assert read_matches(path) == (belief,)


def test_the_columns_are_those_of_the_documentation(tmp_path: Path) -> None:
    stages = StageScores((3, 1), 0.5, 1, 12.25)
    write_matches(
        tmp_path / "m.csv", [Belief(7, 3, 2.0, True, 40, True, probability=0.75, stages=stages, answered_at=9)]
    )
    header, line = (tmp_path / "m.csv").read_text().splitlines()
    assert header == ",".join(MATCH_COLUMNS)
    assert line == "7,3,2.0,true,40,true,0.75,3 1,0.5,1,12.25,9"
    page = (Path(__file__).parents[3] / "docs" / "files.md").read_text().split("### matches.csv")[1].split("### ")[0]
    assert all(f"`{name}`" in page for name in MATCH_COLUMNS)


def test_what_a_table_does_not_have_is_not_known(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text("query,match,score\n7,3,2.5\n8,,\n")
    first, second = read_matches(tmp_path / "m.csv")
    assert first == Belief(7, 3, 2.5, accepted=True)
    assert second == Belief(8, None, 0.0, accepted=False)


@pytest.mark.parametrize(
    ("columns", "cells", "message"),
    [
        ("probability", "1.2", "line 2: expected a probability from 0 to 1, found 1.2"),
        ("probability", "sure", "line 2: expected a finite probability, found 'sure'"),
        ("candidates", "3 9", "line 2: expected a candidate earlier than query 7, found 9"),
        ("candidates", "3 x", "line 2: expected candidates to be a whole number from 0, found 'x'"),
        ("own_score", "inf", "line 2: expected a finite own_score, found 'inf'"),
        ("geometry_match", "7", "line 2: expected a geometry_match earlier than query 7, found 7"),
        ("geometry_score", "-", "line 2: expected a finite geometry_score, found '-'"),
        ("answered_at", "6", "line 2: expected answered_at from query 7 on, found 6"),
    ],
)
def test_a_wrong_cell_of_a_stage_is_named(tmp_path: Path, columns: str, cells: str, message: str) -> None:
    (tmp_path / "m.csv").write_text(f"query,match,score,{columns}\n7,3,2.5,{cells}\n")
    with pytest.raises(DataError, match=message):
        read_matches(tmp_path / "m.csv")


@pytest.mark.parametrize("separator", [",", ";", "\t", " ; "])
@pytest.mark.parametrize("header", [["query", "match", "score"], ["Query", "MATCH", " Score "]])
def test_separators_and_the_case_of_the_header_do_not_matter(tmp_path: Path, separator: str, header: list[str]) -> None:
    path = tmp_path / "m.csv"
    lines = [header, ["20", "3", "0.5"], ["21", "", ""]]
    path.write_text("".join(separator.join(line) + "\n" for line in lines))
    assert [(belief.query, belief.match, belief.score) for belief in read_matches(path)] == [
        (20, 3, 0.5),
        (21, None, 0.0),
    ]
