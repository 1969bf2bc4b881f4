"""The shipped bench profiles: their names, texts and summaries, without the models that check them."""

from itertools import takewhile
from pathlib import Path

_FOLDER = Path(__file__).with_name("profiles")


def profile_names() -> tuple[str, ...]:
    """Names of the shipped profiles."""
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.toml")))


def profile_text(name: str) -> str:
    """The TOML text of a shipped profile."""
    return (_FOLDER / f"{name}.toml").read_text(encoding="utf-8")


def profile_summary(name: str) -> str:
    """What a shipped profile is, in a sentence: the first of the comment at its head."""
    head = takewhile(lambda line: line.startswith("#"), profile_text(name).splitlines())
    return " ".join(line.strip("# ") for line in head).partition(".")[0]
