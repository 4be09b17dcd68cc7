from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vehicle_client.sources.number_text import parse_numbers

numbers = st.floats(-1e6, 1e6, width=32)


@settings(deadline=None)
@given(st.lists(numbers))
def test_four_decimals_come_back_as_python_reads_them(values: list[float]) -> None:
    words = [f"{value:.4f}" for value in values]
    assert parse_numbers("\n".join(words).encode()).tolist() == [float(np.float32(word)) for word in words]


@settings(deadline=None)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False, width=32)))
def test_any_float32_comes_back_to_its_last_bit_or_the_one_beside_it(values: list[float]) -> None:
    read = parse_numbers(" ".join(repr(value) for value in values).encode())
    assert read == pytest.approx(np.array(values, dtype=np.float32), rel=1.2e-7, abs=1.5e-45)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("5", 5),
        ("-.5", -0.5),
        ("+2.", 2),
        ("1e3", 1000),
        ("-1.5E-2", -0.015),
        ("0.1" + "0" * 40, 0.1),
        ("1" * 25, 1e24 / 0.9),
    ],
)
def test_every_way_to_write_a_number_is_read(text: str, value: float) -> None:
    assert parse_numbers(text.encode()) == pytest.approx([value], rel=1e-6)


def test_white_space_of_any_kind_separates() -> None:
    assert parse_numbers(b" 1\t2\r\n3 \n").tolist() == [1, 2, 3]
    assert parse_numbers(b" \n").tolist() == []
    assert parse_numbers(b"").tolist() == []


@pytest.mark.parametrize("text", ["nan", "1 2 x", "1.2.3", "--1", "1e", ".", "-", "1,2", "0x10", "1e5.5", "\x00"])
def test_anything_else_is_refused(text: str) -> None:
    assert parse_numbers(text.encode()) is None


@settings(deadline=None)
@given(st.binary(max_size=60))
def test_any_bytes_give_numbers_or_none(data: bytes) -> None:
    read = parse_numbers(data)
    assert read is None or len(read) == len(data.split())
