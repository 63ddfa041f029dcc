"""`revisit places QUERY --reference REFERENCE`: files, numbers, kinds of ground truth, and one line for a fault."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from odometry import se3
from place_recognition.paradigms.registry import ParadigmsConfig
from slam.cli import app
from slam.datasets.formats.image_sequence import open_image_folder
from slam.errors import ConfigError, DataError
from slam.evaluation.traverse_truth_files import TraverseTruthOptions, positions_from_names
from slam.pipeline.place_recognition import RecognizerFactory, run_recognizer

FILES = {"metrics.json", "matches.csv", "matrix.npz", "precision_recall.csv"} | {
    f"{name}.png" for name in ("matrix", "precision_recall", "stages", "matches")
}
LAP = 30


def views(seed: int) -> list[np.ndarray]:
    """A camera that slides past ever new blobs, LAP images."""
    rng = np.random.default_rng(seed)
    world = np.zeros((160, 1400), np.float32)
    for sigma in (1.5, 3.0, 6.0):
        layer = cv2.GaussianBlur(rng.normal(size=world.shape).astype(np.float32), (0, 0), sigma)
        world += layer / layer.std()
    grey = np.clip(128 + 30 * world, 0, 255).astype(np.uint8)
    return [grey[:, 36 * k : 36 * k + 240] for k in range(LAP)]


def write(folder: Path, images: list[np.ndarray]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for number, image in enumerate(images):
        cv2.imwrite(str(folder / f"{number}.png"), image)
    return folder


def places(source: Path, out: Path, *more: object, paradigm: str = "tracked-words") -> int:
    arguments = ["places", source, "--paradigm", paradigm, "--out", out, *more]
    return app._exit_code(lambda: app.app([str(argument) for argument in arguments]))


def metrics(out: Path) -> dict:
    return json.loads((out / "metrics.json").read_text())


@pytest.fixture(scope="module")
def walks(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A reference, and a query that begins ten images later and is a little darker."""
    root, images = tmp_path_factory.mktemp("walks"), views(3)
    query = [np.clip(0.9 * image, 0, 255).astype(np.uint8) for image in images[10:]]
    return write(root / "query", query), write(root / "reference", images)


@pytest.fixture(scope="module")
def truth(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("truth") / "gt.npz"
    hard = np.eye(LAP - 10, LAP, k=10)
    np.savez(path, truth=hard, soft=sum(np.eye(LAP - 10, LAP, k=k) for k in (9, 10, 11)))
    return path


@pytest.fixture(scope="module")
def matched(walks: tuple[Path, Path], truth: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / "run"
    assert places(walks[0], out, "--reference", walks[1], "--ground-truth", truth) == 0
    return out


def test_every_file_is_written_and_a_sheet_of_matches(matched: Path) -> None:
    assert {path.name for path in matched.iterdir()} == FILES
    sheet = cv2.imread(str(matched / "matches.png"))
    assert sheet is not None
    assert sheet.std() > 10


def test_queries_count_in_the_query_and_matches_in_the_reference(matched: Path) -> None:
    rows = (matched / "matches.csv").read_text().splitlines()[1:]
    found = [line.split(",") for line in rows]
    assert [int(cells[0]) for cells in found] == list(range(LAP - 10))
    accepted = [(int(cells[0]), int(cells[1])) for cells in found if cells[3] == "true"]
    assert len(accepted) > 10
    assert all(abs(match - query - 10) <= 1 for query, match in accepted)
    with np.load(matched / "matrix.npz") as arrays:
        assert arrays["similarity"].shape == (LAP - 10, LAP)
        assert arrays["detections"].tolist() == [list(pair) for pair in accepted]


def test_the_metrics_are_those_of_the_query_beside_a_control(matched: Path) -> None:
    found = metrics(matched)
    assert (found["frames"], found["reference"]["frames"]) == (LAP - 10, LAP)
    assert found["reference_source"].endswith("reference")
    section = found["places"]
    assert section["truth_rows"] == LAP - 10
    assert section["average_precision"] > 0.9
    assert section["stages"]["candidates"]["recall_at_1"] > 0.7
    assert section["control"]["candidates"]["recall_at_1"] < 0.4
    assert set(found["timing_ms"]) == {"total", "read", "features", "place recognition"}


def test_a_wrong_truth_makes_the_figures_bad(walks: tuple[Path, Path], tmp_path: Path) -> None:
    np.savez(tmp_path / "wrong.npz", truth=np.eye(LAP - 10, LAP))
    out = tmp_path / "out"
    assert places(walks[0], out, "--reference", walks[1], "--ground-truth", tmp_path / "wrong.npz") == 0
    assert metrics(out)["places"]["average_precision"] < 0.2


@pytest.mark.parametrize("more", [("--no-temporal",), ("--preset", "published")])
def test_the_temporal_model_may_be_off_and_the_methods_as_published(
    walks: tuple[Path, Path], truth: Path, tmp_path: Path, more: tuple[str, ...]
) -> None:
    out = tmp_path / "out"
    options = ("--reference", walks[1], "--ground-truth", truth, *more)
    assert places(walks[0], out, *options, paradigm="hierarchical-places") == 0
    section = metrics(out)["places"]
    assert section["average_precision"] > 0.7
    assert section["delay_frames"]["max"] == 0
    assert section["probability"] is None


def test_equal_numbers_are_a_truth_and_what_lies_beside_them_is_tolerated(tmp_path: Path) -> None:
    images = views(3)[:15]
    query, reference = write(tmp_path / "query", images), write(tmp_path / "reference", images)
    out = tmp_path / "out"
    options = ("--reference", reference, "--tolerance", 0, "--soft", 2)
    assert places(query, out, *options, paradigm="global-descriptor") == 0
    found = metrics(out)
    assert found["ground_truth"] == "equal numbers, +-0, tolerated to 2"
    assert found["places"]["stages"]["candidates"]["recall_at_1"] == 1.0


def test_poses_of_both_are_a_truth_if_they_are_in_one_frame(walks: tuple[Path, Path], tmp_path: Path) -> None:
    poses = np.array([se3.exp(np.array([0, 0, 0, 4.0 * k, 0, 0])) for k in range(LAP)])
    for name, part in (("query", poses[10:]), ("reference", poses), ("other", poses[:5])):
        lines = [" ".join(f"{value:.6f}" for value in pose[:3].ravel()) for pose in part]
        (tmp_path / f"{name}.txt").write_text("\n".join(lines) + "\n")
    out = tmp_path / "out"
    options = ("--reference", walks[1], "--ground-truth", tmp_path / "query.txt")
    both = (*options, "--reference-truth", tmp_path / "reference.txt", "--max-distance", 5)
    assert places(walks[0], out, *both, paradigm="global-descriptor") == 0
    assert metrics(out)["places"]["stages"]["candidates"]["recall_at_1"] > 0.9
    assert metrics(out)["ground_truth"].endswith("within 5 m and 45 degrees")
    assert places(walks[0], tmp_path / "none", *options) == 2
    assert places(walks[0], tmp_path / "none", *options, "--reference-truth", tmp_path / "other.txt") == 1


def test_positions_in_the_names_are_a_truth_without_an_option(tmp_path: Path) -> None:
    images = views(3)[:12]
    for name in ("queries", "database"):
        (tmp_path / name).mkdir()
        for k, image in enumerate(images):
            cv2.imwrite(str(tmp_path / name / f"@{500000 + 30 * k}.25@4477000.5@17@T@{k}@.png"), image)
    out = tmp_path / "out"
    options = ("--reference", tmp_path / "database", "--no-temporal")
    assert places(tmp_path / "queries", out, *options, paradigm="global-descriptor") == 0
    found = metrics(out)
    assert found["ground_truth"] == "positions in the names of the files within 25 m"
    assert found["places"]["stages"]["candidates"]["recall_at_1"] == 1.0
    assert found["temporal"] is False


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("photo.png", "expected a name that begins with @east@north@"),
        ("@x@4477000.5@17@T@.png", "expected a name that begins with @east@north@"),
        ("@5@nan@17@T@.png", "expected a name that begins with @east@north@"),
        ("@5@6@18@T@.png", "expected all images in one UTM zone, found zones 17 and 18"),
    ],
)
def test_an_odd_name_among_positions_costs_one_line(tmp_path: Path, name: str, message: str) -> None:
    for file in ("@1@2@17@T@a@.png", name):
        cv2.imwrite(str(tmp_path / file), np.zeros((32, 32), np.uint8))
    with pytest.raises(DataError, match=message) as error:
        positions_from_names(open_image_folder(tmp_path))
    assert name in str(error.value)


def test_without_a_truth_the_values_are_null_and_a_hint_is_given(
    walks: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert places(walks[1], out, "--reference", walks[1], paradigm="global-descriptor") == 0
    found = metrics(out)
    assert found["places"]["average_precision"] is None
    assert any("--tolerance" in line for line in found["warnings"])


@pytest.mark.parametrize(
    "more",
    [
        ("--tolerance", 1),  # of unequal numbers of images
        ("--tolerance", -1),
        ("--tolerance", 1, "--ground-truth", "gt.npz"),
        ("--reference-truth", "poses.txt"),
        ("--soft", 0),
        ("--max-distance", 0),
        ("--exclude", 40),
        ("--ground-truth", "nowhere.npz"),
    ],
)
def test_an_option_that_cannot_work_costs_one_line(
    walks: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], more: tuple[object, ...]
) -> None:
    assert places(walks[0], tmp_path / "out", "--reference", walks[1], *more) != 0
    printed = capsys.readouterr()
    assert (
        len([line for line in printed.err.splitlines() if "Error" in line or "expected" in line or "--" in line]) <= 2
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("more", [("--tolerance", 1), ("--soft", 1), ("--reference-truth", "x"), ("--max-distance", 1)])
def test_an_option_of_two_recordings_asks_for_the_other_one(
    walks: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], more: tuple[object, ...]
) -> None:
    assert places(walks[0], tmp_path / "out", *more) != 0
    assert "--reference" in capsys.readouterr().err.replace("\n", " ")


def test_soft_is_at_least_what_must_be_found() -> None:
    with pytest.raises(ConfigError, match="--soft: expected at least"):
        TraverseTruthOptions(tolerance=5, soft=3).check()


def test_images_of_another_size_are_resized_to_those_of_the_reference(walks: tuple[Path, Path], tmp_path: Path) -> None:
    small = [cv2.resize(image, None, fx=0.75, fy=0.75) for image in views(3)]
    out = tmp_path / "out"
    options = ("--reference", walks[1], "--tolerance", 1)
    assert places(write(tmp_path / "small", small), out, *options, paradigm="global-descriptor") == 0
    assert metrics(out)["images_resized"] == LAP
    assert metrics(out)["places"]["stages"]["candidates"]["recall_at_1"] > 0.9


def test_the_same_call_gives_the_same_bits(
    walks: tuple[Path, Path], truth: Path, matched: Path, tmp_path: Path
) -> None:
    out = tmp_path / "again"
    assert places(walks[0], out, "--reference", walks[1], "--ground-truth", truth) == 0
    for name in ("matches.csv", "matrix.npz", "precision_recall.csv"):
        assert (out / name).read_bytes() == (matched / name).read_bytes()


def test_who_stops_before_the_first_query_has_no_results(walks: tuple[Path, Path]) -> None:
    images = views(3)[:4]
    factory = RecognizerFactory("global-descriptor", ParadigmsConfig(reference=True))
    with pytest.raises(KeyboardInterrupt):
        run_recognizer(images, factory, lambda *_: None, lambda: True, images)
    seen: list[int] = []
    run = run_recognizer(images, factory, lambda done, _: seen.append(done), lambda: len(seen) == 6, images)
    assert (run.interrupted, run.images, [belief.query for belief in run.beliefs]) == (True, 2, [0, 1])


@pytest.mark.parametrize("sizes", [(1, 1), (1, 3), (3, 1)])
def test_a_query_or_a_reference_may_be_a_single_image(tmp_path: Path, sizes: tuple[int, int]) -> None:
    query, reference = (write(tmp_path / str(k), views(3)[:size]) for k, size in enumerate(sizes))
    np.savez(tmp_path / "truth.npz", truth=np.eye(*sizes))
    for paradigm in ("seq-slam", "pixel-sequences", "global-descriptor"):
        out = tmp_path / paradigm
        options = ("--reference", reference, "--ground-truth", tmp_path / "truth.npz")
        assert places(query, out, *options, paradigm=paradigm) == 0
        assert metrics(out)["places"]["queries"] == sizes[0]


def test_the_help_names_the_option(capsys: pytest.CaptureFixture[str]) -> None:
    assert app._exit_code(lambda: app.app(["places", "--help"])) == 0
    assert "--reference" in capsys.readouterr().out
