"""Some of the cases of `benches/fuzz.py`, and proof that it sees what it looks for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

fuzz = pytest.importorskip("fuzz", reason="limits and signals of POSIX")

import tmchho  # noqa: E402


def test_hostile_arrays_never_panic_hang_or_abort() -> None:
    assert fuzz.problems(0, 2500) == []


def test_most_functions_answer_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where all were refused at the door, nothing would have been tested."""
    answered = set()

    def noted(name: str, call: Any) -> Any:
        def noting(*arguments: Any) -> None:
            call(*arguments)
            answered.add(name)

        return noting

    calls = tuple((weight, name, noted(name, call)) for weight, name, call in fuzz.CALLS)
    monkeypatch.setattr(fuzz, "CALLS", calls)
    for number in range(700):
        fuzz.run_case(number)
    assert len({name for _, name, _ in calls} - answered) <= 2


def failing(kind: str) -> Any:
    def call(given: Any, _other: Any, _draw: Any) -> None:
        if kind == "panic":
            raise tmchho.TmchhoError("index out of bounds")
        if kind == "odd":
            raise IndexError("7")
        if isinstance(given, np.ndarray) and given.size and given.flags.writeable and given.dtype == float:
            given.ravel(order="K")[0] += 1

    return call


@pytest.mark.parametrize(("kind", "word"), [("panic", "panic"), ("odd", "IndexError"), ("change", "changed")])
def test_what_goes_wrong_is_seen(kind: str, word: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzz, "CALLS", ((1, kind, failing(kind)),))
    monkeypatch.setattr(fuzz, "WEIGHTS", np.ones(1))
    found = [fuzz.run_case(number) for number in range(40)]
    assert any(word in problem for problem in found if problem is not None)
