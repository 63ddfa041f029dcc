"""Matches of another program become beliefs, its poses become loops, and a damaged file is one line."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from odometry import se3
from slam.errors import DataError
from slam.external.matches_file import FileRecognizer, TrustedLoopVerifier, check_matches_file, path_of, short_name
from slam.io.matches import read_proposed_loops
from slam.loop_closing.loop_closer import LoopClosure, Rejection

IMAGE = np.zeros((8, 8), np.uint8)


def written(folder: Path, text: str) -> Path:
    path = folder / "netvlad.csv"
    path.write_text(text)
    return path


def recognize(path: Path, images: int) -> list:
    recognizer = FileRecognizer(read_proposed_loops(path).by_query)
    beliefs = [belief for k in range(images) for belief in recognizer.observe(k, IMAGE, float(k))]
    return beliefs + recognizer.finish()


def test_each_image_gets_one_belief_in_order_and_a_match_is_accepted(tmp_path: Path):
    path = written(tmp_path, "query,match,score\n40,3,0.9\n30,2,0.7\n")
    beliefs = recognize(path, 50)
    assert [belief.query for belief in beliefs] == list(range(50))
    assert [(b.query, b.match, b.score) for b in beliefs if b.accepted] == [(30, 2, 0.7), (40, 3, 0.9)]


def test_each_of_several_proposals_for_a_query_is_proposed_the_surest_first(tmp_path: Path):
    path = written(tmp_path, "query,match,score\n40,3,0.5\n40,4,0.9\n40,5,0.6\n")
    assert [b.match for b in recognize(path, 41) if b.accepted] == [4, 5, 3]
    assert [loop.belief.match for loop in read_proposed_loops(path).best[40]] == [4]
    assert check_matches_file(path, 41) == ()


def test_scores_may_be_missing(tmp_path: Path):
    path = written(tmp_path, "match,query\n3,40\n")
    assert [(b.query, b.match) for b in recognize(path, 41) if b.accepted] == [(40, 3)]
    assert "no column score" in check_matches_file(path, 41)[0]


def test_an_answer_comes_when_the_file_says_so(tmp_path: Path):
    path = written(tmp_path, "query,match,score,answered_at\n5,1,1,8\n6,2,1,8\n")
    recognizer = FileRecognizer(read_proposed_loops(path).by_query)
    answered = [[b.query for b in recognizer.observe(k, IMAGE, 0.0)] for k in range(10)]
    assert answered == [[0], [1], [2], [3], [4], [], [], [], [5, 6, 7, 8], [9]]


def test_a_state_continues_with_the_same_beliefs(tmp_path: Path):
    loops = read_proposed_loops(written(tmp_path, "query,match,score,answered_at\n5,1,1,8\n")).by_query
    whole, first, second = (FileRecognizer(loops) for _ in range(3))
    expected = [b for k in range(12) for b in whole.observe(k, IMAGE, 0.0)]
    found = [b for k in range(7) for b in first.observe(k, IMAGE, 0.0)]
    second.restore(first.state())
    assert found + [b for k in range(7, 12) for b in second.observe(k, IMAGE, 0.0)] == expected


class RefusesAll:
    """A LoopVerifier that refuses every loop."""

    def verify(self, query: int, match: int) -> Rejection:
        return Rejection("not this one")


def test_a_trusted_pose_is_the_loop_and_other_loops_are_verified(tmp_path: Path):
    T = se3.exp(np.array([0.0, 0.3, 0.0, 1.0, 0.0, -2.0]))
    pose = ",".join(map(str, (*T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_quat())))
    path = written(tmp_path, f"query,match,score,x,y,z,qx,qy,qz,qw\n40,3,1,{pose}\n41,4,1,,,,,,,\n")
    verifier = TrustedLoopVerifier(read_proposed_loops(path).by_query, RefusesAll())
    loop = verifier.verify(40, 3)
    assert isinstance(loop, LoopClosure)
    np.testing.assert_allclose(loop.T_match_query, T, atol=1e-12)
    assert np.linalg.eigvalsh(loop.covariance)[0] > 0
    assert isinstance(verifier.verify(41, 4), Rejection)
    assert isinstance(verifier.verify(40, 2), Rejection)  # the pose is that of another match


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("query,match\n90,3\n", r"netvlad\.csv: expected queries below 50, the number of images, found 90"),
        ("query,match\n3,40\n", r"line 2: expected a match earlier than query 3, found 40; swap or correct them"),
        ("query,match,score\n40,3,nan\n", r"line 2: expected a finite score, found 'nan'"),
        ("query,match\n40.5,3\n", r"line 2: expected query to be a whole number from 0, found '40\.5'"),
        ("a,b\n1,2\n", r"expected the columns query, match, found a, b; name them in line 1"),
        ("", r"expected the columns query, match, found an empty file"),
        ("query,match,x,y,z,qx,qy,qz,qw\n40,3,1,2,3,0,0,0,\n", r"line 2: expected a pose .* found no qw"),
        ("query,match,x,y,z,qx,qy,qz,qw\n40,3,1,2,3,0,0,0,0\n", r"line 2: expected a quaternion, found one of length"),
        ("query,match,x,y,z,qx,qy,qz,qw\n40,3,1,2,inf,0,0,0,1\n", r"line 2: expected a finite z, found 'inf'"),
    ],
)
def test_a_damaged_or_foreign_file_is_one_line(tmp_path: Path, text: str, message: str):
    with pytest.raises(DataError, match=message):
        check_matches_file(written(tmp_path, text), 50)


def test_trust_needs_poses(tmp_path: Path):
    path = written(tmp_path, "query,match\n40,3\n")
    with pytest.raises(DataError, match=r"expected relative poses .* found none; leave out --trust-poses"):
        check_matches_file(path, 50, trust_poses=True)


def test_names_of_files():
    assert path_of("tracked-words") is None
    assert path_of("file:a/b.csv") == Path("a/b.csv")
    assert short_name("file:a/b.csv") == "file-b"
