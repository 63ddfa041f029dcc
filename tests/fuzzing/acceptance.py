"""What is expected of a reader: it accepts a file, or refuses it in one line that says what, why, and what to do."""

from pathlib import Path

from slam.errors import RevisitError

from .readers import Reader


def is_accepted(reader: Reader, root: Path, data: bytes) -> bool:
    """Whether a file is accepted.

    Args:
        reader: reader that is tried.
        root: folder prepared with `prepare`.
        data: content of the file.

    Raises:
        AssertionError: the file was refused with a message that does not help, or accepted although it is nonsense.
    """
    (root / reader.file).write_bytes(reader.dressed(data))
    try:
        reader.read(root)
    except RevisitError as error:
        _check_message(str(error), str(root), data)
        _check_memory(error)
        return False
    return True


def prepare(reader: Reader, root: Path) -> None:
    """Make the folder for a reader."""
    (root / reader.file).parent.mkdir(parents=True, exist_ok=True)
    reader.beside(root)


def _check_message(message: str, root: str, data: bytes) -> None:
    named = message.split(": ")[0]  # the file, or one elsewhere that it names
    assert root in named or named.encode() in data, f"names no file: {message}"
    assert message.isprintable(), f"not one printable line: {message!r}"
    assert "expected" in message or "unknown" in message, f"does not say what was expected: {message}"
    assert ";" in message or "--" in message or ": " in message.split(named, 1)[1], f"no remedy: {message}"
    assert len(message) <= 1500, f"{len(message)} characters: {message[:200]}"


def _check_memory(error: BaseException | None) -> None:
    while error is not None:
        assert not isinstance(error, MemoryError), "refused only when the memory was used up"
        error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
