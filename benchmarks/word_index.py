"""The word tree beside FAISS's approximate indices, on maps of many words: a table of times, recall and memory.

    python benchmarks/word_index.py IMAGES... [--images 10000 1000000] [--indices WordTree HNSW IVF]

IMAGES are folders of images, or KITTI sequence folders: words are crossed from their SURF descriptors, 11 for each
image of the map, as tracked-words makes them on the clips of KITTI (see `map_fillers.py`). Queries are real
descriptors. All words are added in batches, as a map gets them while it grows; IVF learns its cells from the words of
the first 10,000 images, since at that time no others are known. Each index is built twice, in processes of their own,
with one thread and with two; times are processor times of the one with one thread, which do not depend on other work of
the machine.

* build: seconds to add all words (for IVF with the training);
* last: milliseconds to add the last batch of 1,100 words (100 images);
* query: milliseconds for the 200 descriptors of one image;
* recall: share of the queries whose nearest word is the one that an exact search finds;
* bytes: growth of the process's resident memory;
* same bits: whether the answers of the two processes are equal.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
import psutil
from command_line import existing, run_script
from map_fillers import TRACKED_WORDS, Material
from numpy.typing import NDArray
from place_benchmarks import image_files

from place_recognition.image_processing.local_features import LocalFeatures
from place_recognition.image_processing.surf import Surf
from place_recognition.vocabulary.word_tree import WordTree

Floats = NDArray[np.float32]
Indices = NDArray[np.int64]

BATCH = 100 * TRACKED_WORDS  # words added at a time
DIMENSION = 64
QUERY = 200  # descriptors of an image that tracked-words looks up
TRAINED = 10_000 * TRACKED_WORDS  # words from which IVF learns its cells
MAX_SOURCE_IMAGES = 115


class Index(Protocol):
    """A growing set of words.

    Attributes:
        efforts: settings of the search that are tried.
    """

    efforts: tuple[int, ...]

    def set_effort(self, effort: int) -> None:
        """Set how thoroughly to search."""
        ...

    def add(self, words: Floats) -> None:
        """Append words (K, D)."""
        ...

    def nearest(self, queries: Floats) -> Indices:
        """Find the nearest word (N,) of each query (N, D)."""
        ...


class Tree:
    """The product's own tree (an Index); how many cells a search follows depends on its size alone."""

    efforts = (0,)

    def __init__(self) -> None:
        self._tree = WordTree()
        self.add, self.nearest = self._tree.add, self._tree.nearest

    def set_effort(self, effort: int) -> None:
        """Do nothing: the tree has no such setting."""


class Hnsw:
    """FAISS's navigable small world graph (an Index): 32 neighbours a word, 40 candidates while it is built."""

    efforts = (16, 64)

    def __init__(self) -> None:
        import faiss

        self._index = faiss.IndexHNSWFlat(DIMENSION, 32)

    def set_effort(self, effort: int) -> None:
        """Set the number of candidates that a search keeps (efSearch)."""
        self._index.hnsw.efSearch = effort

    def add(self, words: Floats) -> None:
        """Append words."""
        self._index.add(words)

    def nearest(self, queries: Floats) -> Indices:
        """Find the nearest words."""
        return np.asarray(self._index.search(queries, 1)[1][:, 0], np.int64)


class Ivf:
    """FAISS's inverted file (an Index): 4,096 cells, of which the words of the nearest are compared."""

    efforts = (16, 64)

    def __init__(self) -> None:
        import faiss

        self._cells = faiss.IndexFlatL2(DIMENSION)
        self._index = faiss.IndexIVFFlat(self._cells, DIMENSION, 4096)

    def set_effort(self, effort: int) -> None:
        """Set the number of cells whose words a search compares (nprobe)."""
        self._index.nprobe = effort

    def add(self, words: Floats) -> None:
        """Append words; the cells are learnt from the first ones."""
        if not self._index.is_trained:
            self._index.train(words)
        self._index.add(words)

    def nearest(self, queries: Floats) -> Indices:
        """Find the nearest words."""
        return np.asarray(self._index.search(queries, 1)[1][:, 0], np.int64)


INDICES: dict[str, Callable[[], Index]] = {"WordTree": Tree, "HNSW": Hnsw, "IVF": Ivf}


def word_batches(material: Material, count: int) -> Iterator[Floats]:
    """Make words, first as many as IVF learns from, then batch by batch; the same ones each time."""
    material.rng = np.random.default_rng(2)
    done = min(TRAINED, count)
    yield np.concatenate([material.descriptors(min(BATCH, done - begin)) for begin in range(0, done, BATCH)])
    while done < count:
        yield material.descriptors(min(BATCH, count - done))
        done += BATCH


def find_exactly(material: Material, count: int, queries: Floats) -> Indices:
    """Compare each query with every word."""
    nearest, best, done = np.zeros(len(queries), np.int64), np.full(len(queries), -np.inf), 0
    for words in word_batches(material, count):
        closeness = queries @ words.T - np.float32(0.5) * np.einsum("kd,kd->k", words, words)
        closest = closeness.argmax(axis=1)
        value = closeness[np.arange(len(queries)), closest]
        nearer = value > best
        nearest[nearer], best[nearer] = done + closest[nearer], value[nearer]
        done += len(words)
    return nearest


def measure(name: str, material: Material, count: int, queries: Floats) -> dict[str, Any]:
    """Build one index and query it; runs in a process of its own."""
    index, process = INDICES[name](), psutil.Process()
    before, build, last = process.memory_info().rss, 0.0, 0.0
    for words in word_batches(material, count):
        begin = time.process_time()
        index.add(words)
        last = time.process_time() - begin
        build += last
    grown = process.memory_info().rss - before
    return {
        "build": build,
        "last": 1e3 * last,
        "bytes": grown,
        "asked": [ask(index, e, queries) for e in index.efforts],
    }


def ask(index: Index, effort: int, queries: Floats) -> dict[str, Any]:
    """Look up all queries, image by image, with one setting of the search."""
    index.set_effort(effort)
    index.nearest(queries[:QUERY])  # compiles and warms up
    begin = time.process_time()
    found = [index.nearest(queries[at : at + QUERY]) for at in range(0, len(queries), QUERY)]
    took = (time.process_time() - begin) * QUERY / len(queries)
    return {"effort": effort, "query": 1e3 * took, "answers": np.concatenate(found).tolist()}


def load_descriptors(folders: list[Path]) -> Floats:
    """Describe images spread evenly over the folders."""
    files = [file for folder in folders for file in image_files(folder)]
    surf = Surf()
    chosen = files[:: max(1, len(files) // MAX_SOURCE_IMAGES)]
    return np.concatenate([surf.extract(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)).descriptors for file in chosen])


def make_material(descriptors: Floats) -> Material:
    """Material whose words are crossed from descriptors."""
    count = len(descriptors)
    blank = np.zeros(count, np.float32)
    return Material([LocalFeatures(np.zeros((count, 2), np.float32), blank, blank, descriptors)])


def run_apart(name: str, threads: int, file: Path, count: int, queries: int) -> dict[str, Any]:
    """Measure an index in a process with a number of threads."""
    environment = os.environ | {"OMP_NUM_THREADS": str(threads), "OPENBLAS_NUM_THREADS": str(threads)}
    command = [sys.executable, __file__, str(file), "--queries", str(queries), "--one", name, "--images", str(count)]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    measured: dict[str, Any] = json.loads(run.stdout.splitlines()[-1])
    return measured


def report(name: str, runs: list[dict[str, Any]], exact: Indices, words: int) -> None:
    """Print a line for each setting of the search; times are those of the first run."""
    for k, asked in enumerate(runs[0]["asked"]):
        answers = [run["asked"][k]["answers"] for run in runs]
        same = "" if len(runs) == 1 else f"same bits {'yes' if answers[0] == answers[1] else 'NO'}"
        print(
            f"{name:8s} {asked['effort'] or '':3} build {runs[0]['build']:7.1f} s  last {runs[0]['last']:7.1f} ms  "
            f"query {asked['query']:7.2f} ms  recall {np.mean(np.array(answers[0]) == exact):.4f}  "
            f"{runs[0]['bytes'] / words:5.0f} bytes a word  {same}",
            flush=True,
        )


def main() -> None:
    """Measure every index at every size."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=existing, metavar="IMAGES")
    parser.add_argument("--images", nargs="+", type=int, default=[10_000, 1_000_000], help="images of the map")
    parser.add_argument("--queries", type=int, default=2000, help="descriptors asked about")
    parser.add_argument("--indices", nargs="+", choices=INDICES, default=list(INDICES))
    parser.add_argument("--threads", nargs="+", type=int, default=[1, 2], help="of each run")
    parser.add_argument("--one", choices=INDICES, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        material = make_material(np.load(options.folders[0]))
        words = options.images[0] * TRACKED_WORDS
        print(json.dumps(measure(options.one, material, words, material.queries(options.queries))))
        return
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "descriptors.npy"
        np.save(file, load_descriptors(options.folders))
        material = make_material(np.load(file))
        for images in options.images:
            words = images * TRACKED_WORDS
            exact = find_exactly(material, words, material.queries(options.queries))
            print(f"{images:,} images, {words:,} words", flush=True)
            for name in options.indices:
                runs = [run_apart(name, threads, file, images, options.queries) for threads in options.threads]
                report(name, runs, exact, words)


if __name__ == "__main__":
    run_script(main)
