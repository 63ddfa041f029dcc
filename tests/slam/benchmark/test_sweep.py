"""The file of a benchmark: what it makes, and one line for whatever is wrong with it."""

import contextlib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slam.benchmark.sweep import BenchmarkOptions, make_jobs
from slam.benchmark.sweep_config import parse_sweep, read_sweep
from slam.config import RunConfig
from slam.datasets.dataset import DatasetSpec
from slam.errors import ConfigError

SOURCE = '[[sources]]\npath = "drive"\n'


def written(folder: Path, text: str) -> Path:
    (folder / "sweep.toml").write_text(text, encoding="utf-8")
    return folder / "sweep.toml"


def test_every_combination_is_a_job_of_its_own_name(tmp_path: Path):
    lists = 'paradigms = ["tracked-words", "pixel-sequences"]\nrobust = ["gnc", "pcm+gnc"]\nseeds = [0, 7]\n'
    two = '[[sources]]\npath = "kitti"\nsequence = "05"\n[[sources]]\nsimulate = "blocks"\nlaps = 2\nlength_m = 300\n'
    sweep = read_sweep(written(tmp_path, lists + two))
    jobs = make_jobs(sweep, tmp_path / "out")
    assert len({job.name for job in jobs}) == len(jobs) == 2 * 2 * 2 * 2
    assert jobs == make_jobs(sweep, tmp_path / "out")
    first, last = jobs[0], jobs[-1]
    assert first.name == "kitti-05.tracked-words.gnc.0"
    assert first.source == DatasetSpec(tmp_path / "kitti", "05")
    assert last.name == "blocks-laps-2-length_m-300.pixel-sequences.pcm+gnc.7"
    assert (last.config.paradigm, last.config.robust, last.config.seed) == ("pixel-sequences", "pcm+gnc", 7)


def test_presets_are_an_axis_of_the_sweep(tmp_path: Path):
    jobs = make_jobs(read_sweep(written(tmp_path, 'preset = ["default", "published"]\n' + SOURCE)), tmp_path)
    assert [job.name for job in jobs] == [
        f"drive.tracked-words.{preset}.pcm+gnc.0" for preset in ("default", "published")
    ]
    assert [job.config.place_recognition.preset for job in jobs] == ["default", "published"]
    words = list(jobs[1].command)
    assert words[words.index("--preset") + 1] == "published"
    (job,) = make_jobs(read_sweep(written(tmp_path, 'preset = "published"\n' + SOURCE)), tmp_path)
    assert job == jobs[1]


def test_without_a_preset_that_of_the_settings_holds_and_names_are_as_ever(tmp_path: Path):
    (tmp_path / "own.toml").write_text("[place_recognition]\npreset = 'published'\n")
    (job,) = make_jobs(read_sweep(written(tmp_path, 'config = "own.toml"\n' + SOURCE)), tmp_path)
    assert job.config.place_recognition.preset == "published"
    assert job.name == "drive.tracked-words.pcm+gnc.0"
    assert "--preset" not in job.command
    (job,) = make_jobs(read_sweep(written(tmp_path, 'config = "own.toml"\npreset = "default"\n' + SOURCE)), tmp_path)
    assert job.config.place_recognition.preset == "default"


def test_what_is_not_named_is_as_in_a_single_run(tmp_path: Path):
    (job,) = make_jobs(read_sweep(written(tmp_path, SOURCE)), tmp_path)
    assert job.config == RunConfig(save_recording=False, save_map=False)


def test_the_settings_file_lies_beside_the_benchmark(tmp_path: Path):
    (tmp_path / "own.toml").write_text(f"[key_frames]\n{key_frame_setting()} = 3.0\n")
    (job,) = make_jobs(read_sweep(written(tmp_path, 'config = "own.toml"\nseeds = [4]\n' + SOURCE)), tmp_path)
    assert getattr(job.config.key_frames, key_frame_setting()) == 3.0
    assert job.config.seed == 4


def key_frame_setting() -> str:
    return next(name for name, value in vars(RunConfig().key_frames).items() if isinstance(value, float))


def test_the_command_of_a_job_makes_the_same_run(tmp_path: Path):
    (job,) = make_jobs(
        read_sweep(written(tmp_path, 'seeds = [3]\n[[sources]]\npath = "a b"\nformat = "kitti"\n')), tmp_path
    )
    words = list(job.command)
    assert words[:2] == ["run", str(tmp_path / "a b")]
    assert {"--no-record", "--format"} <= set(words)
    assert words[words.index("--seed") + 1] == "3"
    assert words[words.index("--out") + 1] == str(job.folder)


def test_a_hostile_name_stays_inside_its_folder(tmp_path: Path):
    (job,) = make_jobs(read_sweep(written(tmp_path, SOURCE + 'name = "../<b>\\"улица"\n')), tmp_path / "out")
    assert job.folder.resolve().parent == tmp_path / "out" / "jobs"
    assert "улица" in job.name
    assert not job.name.startswith(".")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sources = 3", "sources"),
        ("", "sources"),
        ("[[sources]]", "path = ... or with simulate"),
        ('[[sources]]\npath = "a"\nsimulate = "circle"', "path = ... or with simulate"),
        ("[[sources]]\npath = 3", "path: expected str, found 3"),
        ('[[sources]]\npath = "a"\nsequence = 5', "sequence: expected str, found 5"),
        ('[[sources]]\npath = "a"\ncolour = "red"', "unknown setting 'colour'"),
        ('[[sources]]\npath = "a"\nname = 1', "name: expected str, found 1"),
        ('[[sources]]\nsimulate = "spiral"', "spiral"),
        ("[[sources]]\nsimulate = 3", "found 3"),
        ('[[sources]]\nsimulate = "circle"\nlaps = 0', "laps"),
        ('[[sources]]\nsimulate = "circle"\nlaps = "two"', "laps: expected int, found 'two'"),
        (SOURCE + SOURCE, "found 'drive' twice"),
        ("paradigms = []\n" + SOURCE, "paradigms: expected one or more"),
        ('paradigms = "tracked-words"\n' + SOURCE, "paradigms: expected a list, found 'tracked-words'"),
        ('robust = ["gnc", "gnc"]\n' + SOURCE, "found 'gnc' twice"),
        ('seeds = ["0"]\n' + SOURCE, "found '0'"),
        ("seeds = [true]\n" + SOURCE, "found True"),
        ("seeds = [-1]\n" + SOURCE, "found -1"),
        ('preset = "chapter"\n' + SOURCE, "preset: unknown preset 'chapter': expected one of default, published"),
        ("preset = []\n" + SOURCE, "preset: expected one or more"),
        ("preset = 3\n" + SOURCE, "found 3"),
        ('preset = ["default", "default"]\n' + SOURCE, "found 'default' twice"),
        ("speed = 3\n" + SOURCE, "unknown setting 'speed'"),
        ("seeds = [", "expected a TOML file"),
        ("seeds = " + 9999 * "[", "expected a TOML file"),
        ("seeds = [" + 9999 * "1" + "]", "expected a TOML file"),
        ('[[sources]]\npath = "\\u0000"', "path: expected a path"),
        (f'[[sources]]\nsimulate = "{999 * "x"}"', "simulate: expected a path"),
        ('config = "\\u0000"\n' + SOURCE, "config: expected a path"),
        (
            '[[sources]]\nsimulate = "circle"\nlength_m = 1' + 400 * "0",
            "length_m: expected a number, found one beyond all bounds",
        ),
        ('[[sources]]\nsimulate = "circle"\nlaps = 1' + 400 * "0", "int too large"),
    ],
)
def test_a_fault_is_one_line_that_names_the_file_and_what_was_found(tmp_path: Path, text: str, message: str):
    with pytest.raises(ConfigError) as error:
        read_sweep(written(tmp_path, text))
    assert message in str(error.value)
    assert "\n" not in " ".join(str(error.value).splitlines())


words = st.text(max_size=8) | st.sampled_from(["circle", "kitti", "tracked-words", "\0", "~", "~nobody", "..", "/"])
things = st.none() | st.booleans() | st.integers() | st.just(10**400) | st.floats() | words
recorded = st.fixed_dictionaries({"path": words}, optional=dict.fromkeys(["sequence", "format", "name"], words))
simulated = st.fixed_dictionaries(
    {"simulate": st.just("circle") | words},
    optional=dict.fromkeys(["laps", "length_m", "seed", "clean", "name"], things),
)
entries = st.lists(recorded | simulated | st.dictionaries(words, things, max_size=2) | things, max_size=3)
sweeps = st.fixed_dictionaries(
    {"sources": entries},
    optional={
        "paradigms": st.lists(st.sampled_from(["tracked-words", "pixel-sequences"]), max_size=2) | things,
        "seeds": st.lists(st.integers(0), min_size=1, max_size=2, unique=True) | things,
        "config": words,
        "record": st.booleans(),
        "preset": st.lists(st.sampled_from(["default", "published"]), max_size=3) | things,
    },
)


@settings(max_examples=300, deadline=None)
@given(sweeps)
def test_whatever_the_file_holds_it_gives_a_sweep_or_a_message(values: dict):
    with contextlib.suppress(ConfigError):
        sweep = parse_sweep(values, Path("/folder/sweep.toml"))
        jobs = make_jobs(sweep, Path("/out"))
        assert len({job.folder for job in jobs}) == len(jobs) >= 1
        assert {job.folder.parent for job in jobs} == {Path("/out/jobs")}


def test_a_file_that_is_not_there_is_named(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"nowhere\.toml"):
        read_sweep(tmp_path / "nowhere.toml")


@pytest.mark.parametrize(("workers", "scheduler"), [(-1, None), (2, "tcp://127.0.0.1:1")])
def test_an_executor_that_cannot_be_made_is_refused(tmp_path: Path, workers: int, scheduler: str | None):
    with pytest.raises(ConfigError, match="--workers"):
        BenchmarkOptions(tmp_path, tmp_path, workers, scheduler).make_executor()
