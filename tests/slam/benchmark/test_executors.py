"""Whoever does the work, the results are the same, whatever dies meanwhile."""

import os
import time
from pathlib import Path

import cv2
import dask
import distributed
import psutil
import pytest

from slam.benchmark.executors import Completed, DaskExecutor, Executor, Failed, SerialExecutor, make_executor
from slam.errors import ConfigError


@pytest.fixture(params=["one process", "cluster"])
def executor(request: pytest.FixtureRequest) -> Executor:
    """Each of them, begun."""
    return SerialExecutor() if request.param == "one process" else request.getfixturevalue("cluster")


def dies_once(mark: Path, number: int) -> int:
    """The number; the process that first comes to 1 dies."""
    if number == 1 and not mark.exists():
        mark.touch()
        os._exit(1)
    return number


def test_every_item_is_done_once(executor: Executor):
    ended = list(executor.run(lambda number: number**2, range(5)))
    assert sorted((done.item, done.result) for done in ended if isinstance(done, Completed)) == [
        (0, 0), (1, 1), (2, 4), (3, 9), (4, 16)
    ]  # fmt: skip
    assert list(executor.run(abs, [])) == []


def test_an_item_whose_process_dies_is_done_by_another(tmp_path: Path, cluster: DaskExecutor):
    ended = list(cluster.run(lambda number: dies_once(tmp_path / "run", number), range(4)))
    assert sorted(done.result for done in ended if isinstance(done, Completed)) == [0, 1, 2, 3]
    assert (tmp_path / "run").exists()


def test_an_item_that_kills_whatever_does_it_is_given_up(cluster: DaskExecutor):
    def dies(number: int) -> int:
        if number == 0:
            os._exit(1)
        return number

    ended = {ended.item: ended for ended in cluster.run(dies, range(2))}
    assert isinstance(ended[0], Failed)
    assert "the worker failed" in ended[0].reason
    assert "\n" not in ended[0].reason
    assert ended[1] == Completed(1, 1)


def settings_there(_: int) -> tuple[object, ...]:
    """Of the process that is asked."""
    names = ("OMP_NUM_THREADS", "MALLOC_TRIM_THRESHOLD_")
    return (*map(os.environ.get, names), cv2.getNumThreads(), dask.config.get("distributed.worker.profile.enabled"))


def test_our_own_processes_share_the_cores_and_keep_the_memory_that_they_free(cluster: DaskExecutor):
    assert list(cluster.run(settings_there, [0])) == [Completed(0, ("1", None, 1, False))]


def test_an_existing_scheduler_is_used_and_left_running(cluster: DaskExecutor):
    for _ in range(2):
        with DaskExecutor(0, cluster.address) as guest:
            (ended,) = guest.run(lambda _: os.getpid(), [0])
        assert isinstance(ended, Completed)
        assert ended.result in {child.pid for child in psutil.Process().children(recursive=True)}


def test_a_scheduler_whose_greeting_comes_with_other_news_is_greeted_again(
    cluster: DaskExecutor, monkeypatch: pytest.MonkeyPatch
):
    client, calls = distributed.Client, []

    def disturbed_once(*arguments: object, **settings: object) -> distributed.Client:
        calls.append(arguments)
        assert len(calls) > 1
        return client(*arguments, **settings)

    monkeypatch.setattr(distributed, "Client", disturbed_once)
    with DaskExecutor(0, cluster.address) as guest:
        assert list(guest.run(abs, [-3])) == [Completed(-3, 3)]
    assert len(calls) == 2


def test_a_scheduler_that_does_not_answer_is_named(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("slam.benchmark.executors._CONNECT_TIMEOUT_S", 0.2)
    with pytest.raises(ConfigError, match="--scheduler tcp://127"), DaskExecutor(0, "tcp://127.0.0.1:1"):
        pass


def test_results_come_as_they_are_ready_and_an_error_of_one_item_is_its_own(tmp_path: Path, cluster: DaskExecutor):
    def waits(number: int) -> int:
        if number == 1:
            raise RuntimeError("out\nof luck")
        while number == 0 and not (tmp_path / "go").exists():
            time.sleep(0.01)
        return number

    ended = cluster.run(waits, range(3))
    early = {next(ended), next(ended)}
    assert early == {
        Failed(1, "the worker failed: out of luck"),
        Completed(2, 2),
    }  # the first waits until these were seen
    (tmp_path / "go").touch()
    assert next(ended) == Completed(0, 0)


def test_nothing_listens_beyond_this_machine(cluster: DaskExecutor):
    ours = psutil.Process()
    listening = [
        connection.laddr.ip
        for process in (ours, *ours.children(recursive=True))
        for connection in process.net_connections(kind="inet")
        if connection.status == psutil.CONN_LISTEN
    ]
    assert len(listening) >= 3  # a scheduler and two workers
    assert set(listening) == {"127.0.0.1"}


def test_the_executor_is_the_one_asked_for():
    assert isinstance(make_executor(None, None, 0), SerialExecutor)
    assert isinstance(make_executor(0, None, 2), SerialExecutor)
    assert isinstance(make_executor(None, "tcp://127.0.0.1:1", 0), DaskExecutor)
    with pytest.raises(ConfigError, match="expected 0 or more, found -1"):
        make_executor(-1, None, 0)
    with pytest.raises(ConfigError, match="no --workers beside it"):
        make_executor(1, "tcp://127.0.0.1:1", 0)
