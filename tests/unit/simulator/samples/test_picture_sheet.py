from __future__ import annotations

import cv2
import numpy as np
import pytest

from simulator.samples.gallery import gallery_sample
from simulator.samples.picture_sheet import PICTURE_PX, caption, draw_sheet, photographs
from simulator.samples.sample import Sample, SampleKind, Wishes, make_sample
from simulator.shapes.debris import DebrisKind

HOLE = make_sample(SampleKind.POTHOLE, 1, Wishes(0.7, 0.6, 0.10, lobes=1, water=0.0))
TYRE = make_sample(SampleKind.DEBRIS, 1, Wishes(0.65, 0.65, 0.2, shape=DebrisKind.TYRE))


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    return photographs([HOLE, TYRE])


def middle(picture: np.ndarray) -> np.ndarray:
    height, width = picture.shape[:2]
    return picture[height * 2 // 5 : height * 3 // 5, width * 2 // 5 : width * 3 // 5].astype(float)


def test_each_sample_has_a_picture(pictures: list[np.ndarray]) -> None:
    assert [picture.shape for picture in pictures] == [(PICTURE_PX[1], PICTURE_PX[0], 3)] * 2
    assert all(picture.dtype == np.uint8 for picture in pictures)


def test_what_is_pictured_lies_in_the_middle_and_differs_from_the_road(pictures: list[np.ndarray]) -> None:
    hole, tyre = pictures
    beside = np.s_[PICTURE_PX[1] * 4 // 5 :, : PICTURE_PX[0] // 5]
    # Walls in the shade and lit stones: a hole is more varied than asphalt; rubber is darker.
    assert middle(hole).std() > 1.3 * hole[beside].astype(float).std()
    assert middle(tyre).mean() < 0.8 * tyre[beside].mean()


def test_a_sheet_is_the_same_each_time_and_reads_as_a_picture() -> None:
    one, again = draw_sheet([HOLE]), draw_sheet([HOLE])
    assert one == again
    sheet = cv2.imdecode(np.frombuffer(one, np.uint8), cv2.IMREAD_COLOR)
    assert sheet.shape[1] >= PICTURE_PX[0]
    assert sheet.shape[0] > PICTURE_PX[1]


def test_captions_say_what_it_is_and_how_large() -> None:
    assert caption(gallery_sample(14, 1))[0] == "flat-top hump"
    assert caption(TYRE) == ("tyre", "0.65 x 0.65 m, 20.0 cm high")
    title, sizes = caption(HOLE)
    assert title == "pothole"
    assert sizes.endswith("10.0 cm deep")


@pytest.mark.parametrize("count", [0, 25])
def test_a_sheet_of_none_or_too_many_is_refused(count: int) -> None:
    samples: list[Sample] = [HOLE] * count
    with pytest.raises(ValueError, match="1 to 24 samples"):
        photographs(samples)
