"""`revisit vocabulary train`: images in, a file of words out, or one line that says why not."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from place_recognition.vocabulary.vocabulary import load_vocabulary
from slam.cli import app


def textures(folder: Path, count: int, seed: int = 0) -> Path:
    folder.mkdir(parents=True)
    rng = np.random.default_rng(seed)
    for k in range(count):
        noise = cv2.GaussianBlur(rng.normal(size=(160, 240)), (0, 0), 2)
        cv2.imwrite(str(folder / f"{k:06d}.png"), np.clip(128 + 200 * noise, 0, 255).astype(np.uint8))
    return folder


def train(*arguments: object) -> int:
    return app._exit_code(lambda: app.app(["vocabulary", "train", *map(str, arguments)]))


def test_words_come_from_all_sources(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder = textures(tmp_path / "photos", 2)
    for sequence in ("00", "01"):
        textures(tmp_path / "kitti" / "sequences" / sequence / "image_0", 1, int(sequence) + 1)
    out = tmp_path / "own.vocabulary"
    assert train(folder, tmp_path / "kitti", "--words", 20, "--out", out) == 0
    vocabulary = load_vocabulary(out)
    assert vocabulary.kind == "surf-upright-64"
    assert len(vocabulary) == 20
    assert "20 words of surf-upright-64" in (said := capsys.readouterr().out)
    assert "of 4 images" in said


@pytest.mark.parametrize(
    ("features", "kind"),
    [("surf-oriented", "surf-64"), ("sift", "sift-128"), ("orb", "orb-256"), ("brief", "brief-256")],
)
def test_words_are_made_of_the_features_asked_for(tmp_path: Path, features: str, kind: str):
    out = tmp_path / "own.vocabulary"
    assert train(textures(tmp_path / "photos", 2), "--features", features, "--words", 30, "--out", out) == 0
    assert load_vocabulary(out).kind == kind
    bytes_a_word = {"orb-256": 32, "brief-256": 32, "sift-128": 128, "surf-64": 64}[kind]
    assert out.stat().st_size < 30 * (bytes_a_word + 8) + 300


def test_the_same_images_and_seed_give_the_same_file(tmp_path: Path):
    folder = textures(tmp_path / "photos", 2)
    for name in ("a", "b"):
        assert train(folder, "--words", 20, "--sample", 100, "--seed", 3, "--out", tmp_path / name) == 0
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--features", "sift-of-the-moon"], 2, "unknown local features 'sift-of-the-moon': expected one of surf"),
        (["--words", "0"], 2, "expected words and iterations from 1"),
        (["--words", "100000"], 1, "expected at least 100000 descriptors"),
        (["--out", "nowhere/own.vocabulary"], 1, "nowhere/own.vocabulary: expected a file to write"),
        (["--out", "photos"], 1, "photos: expected a file to write in a folder that exists, found a folder"),
    ],
)
def test_what_cannot_work_is_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    code: int,
    message: str,
):
    monkeypatch.chdir(tmp_path)
    textures(tmp_path / "photos", 1)
    assert train("photos", "--out", "own.vocabulary", *arguments) == code
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert [item.name for item in tmp_path.iterdir()] == ["photos"]


def test_a_source_without_images_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "empty").mkdir()
    assert train(tmp_path / "empty", "--out", tmp_path / "own.vocabulary") == 1
    assert f"{tmp_path / 'empty'}: expected" in capsys.readouterr().err


def test_a_damaged_image_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (textures(tmp_path / "photos", 1) / "000001.png").write_bytes(b"not an image")
    assert train(tmp_path / "photos", "--out", tmp_path / "own.vocabulary") == 1
    assert "000001.png: expected an image" in capsys.readouterr().err
