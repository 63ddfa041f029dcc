"""No file makes a reader crash: each is accepted, or refused by one line that names it and says what to do."""

import random
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from .acceptance import is_accepted, prepare
from .mutations import mutated
from .readers import READERS

CORPUS = Path(__file__).parent / "corpus"  # files that once made a reader fail
SLOW = ("video", "bag")

few = settings(
    max_examples=12, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def folder_of(name: str) -> Path:
    return CORPUS / name.replace(",", "").replace(".", "").replace(" ", "-")


@pytest.fixture(params=READERS)
def name(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    prepare(READERS[request.param], tmp_path)
    return request.param


def test_a_valid_file_is_accepted(name: str, tmp_path: Path) -> None:
    assert is_accepted(READERS[name], tmp_path, READERS[name].seeds()[0])


def test_files_that_once_made_a_reader_fail_do_so_no_more(name: str, tmp_path: Path) -> None:
    for file in sorted(folder_of(name).glob("*")):
        is_accepted(READERS[name], tmp_path, file.read_bytes())


@few
@given(data=st.data())
def test_any_file_is_accepted_or_refused_by_name(name: str, tmp_path: Path, data: st.DataObject) -> None:
    reader = READERS[name]
    damaged = st.integers(0, 2**32).map(lambda seed: mutated(random.Random(seed), reader.seeds()))
    is_accepted(reader, tmp_path, data.draw(damaged if name.startswith(SLOW) else damaged | reader.generated))


def test_every_found_file_belongs_to_a_reader() -> None:
    assert {path.name for path in CORPUS.iterdir()} <= {folder_of(name).name for name in READERS}
