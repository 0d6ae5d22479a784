"""The picture of the rooms is the code's."""

from __future__ import annotations

import runpy

from tests.support import ROOT


def test_the_picture_is_drawn_from_the_code() -> None:
    rooms = runpy.run_path(str(ROOT / "docs" / "extensions" / "rooms_picture.py"))
    assert rooms["PICTURE"].read_text() == rooms["picture"](), "run python docs/extensions/rooms_picture.py"
