"""NPZ files that are spoilt in any way: one sentence that names the file, whatever zlib, zipfile,
lzma or NumPy raise.
"""

import zipfile
from pathlib import Path

import numpy as np
import pytest
from crowd_lod_extension.crowd_lod.errors import CrowdError
from crowd_lod_extension.crowd_lod.npz_file import read_arrays
from crowd_lod_extension.crowd_lod.shot import plan_file

HEADER = b"\x93NUMPY\x01\x00"


def bytes_of(path: Path) -> bytearray:
    np.savez_compressed(path, a=np.arange(1000), b=np.linspace(0, 1, 1000))
    return bytearray(path.read_bytes())


def patched(path: Path, field: int, value: int) -> None:
    """Write two bytes into the same field of all local and central headers of the archive."""
    content = bytes_of(path)
    for mark, shift in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        place = content.find(mark)
        while place >= 0:
            content[place + shift + field : place + shift + field + 2] = value.to_bytes(2, "little")
            place = content.find(mark, place + 4)
    path.write_bytes(content)


def noisy(path: Path, place: int) -> None:
    content = bytes_of(path)
    content[place : place + 40] = bytes(40)
    path.write_bytes(content)


def member(path: Path, content: bytes, method: int = zipfile.ZIP_STORED) -> None:
    with zipfile.ZipFile(path, "w", method) as archive:
        for name in "ab":
            archive.writestr(f"{name}.npy", content)


def headed(text: bytes) -> bytes:
    return HEADER + len(text).to_bytes(2, "little") + text


def bad_lzma(path: Path) -> None:
    member(path, np.arange(9999).tobytes(), zipfile.ZIP_LZMA)
    content = bytearray(path.read_bytes())
    content[60:90] = b"\xff" * 30
    path.write_bytes(content)


SPOILT = {
    "empty": lambda path: path.write_bytes(b""),
    "text": lambda path: path.write_text("a b"),
    "cut": lambda path: path.write_bytes(bytes_of(path)[:900]),
    "bad zlib stream": lambda path: noisy(path, 60),
    "bad directory": lambda path: noisy(path, len(bytes_of(path)) - 60),
    "encrypted": lambda path: patched(path, 0, 1),
    "unknown method": lambda path: patched(path, 2, 99),
    "bad lzma": bad_lzma,
    "no array": lambda path: member(path, b"hello"),
    "deep header": lambda path: member(path, headed(b"(" * 9000)),
    "endless minus": lambda path: member(path, headed(b"-" * 9000)),
    "more than there is": lambda path: member(
        path, headed(b"{'descr': '<f8', 'fortran_order': False, 'shape': (10**9,)}")
    ),
    "huge shape": lambda path: member(
        path, headed(b"{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999999,), }")
    ),
    "bytes left over": lambda path: member(
        path, headed(b"{'descr': '<f8', 'fortran_order': False, 'shape': (0,), }") + b"x"
    ),
    "objects": lambda path: np.savez(path, a=np.array([None]), b=1),
    "no b": lambda path: np.savez(path, a=1),
}


@pytest.mark.parametrize("fault", SPOILT)
def test_a_spoilt_file_is_one_sentence_that_names_it(tmp_path, fault):
    path = tmp_path / "bad.npz"
    SPOILT[fault](path)
    with pytest.raises(
        CrowdError, match=r"^The file .*bad\.npz (cannot be read|lacks b).*write it again"
    ) as told:
        read_arrays(path, ("a", "b"))
    assert len(str(told.value).splitlines()) == 1
    with pytest.raises(CrowdError, match=r"^The shot plan .*bad\.npz .*press Plan Shot again"):
        plan_file.read(path)


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path):
    np.savez_compressed(tmp_path / "bomb.npz", a=np.zeros(10_000_000, np.int8))
    with pytest.raises(CrowdError, match="unpacks to"):
        read_arrays(tmp_path / "bomb.npz", ("a",), most_bytes=1 << 20)


def plan_arrays() -> dict:
    return {
        "version": np.array(plan_file.VERSION),
        "numbers": np.array([1, 2]),
        "times": np.array([1.0, 2.0]),
        "cameras": np.zeros((2, 1, plan_file.CAMERA_SIZE)),
        "shift": np.zeros(3, np.uint8),
        "finer": np.zeros(3, np.uint8),
        "counts": np.full(1, 4, np.uint8),
        "cast": np.ones((1, 16), bool),
        "made_of": np.array([("the crowd", "12")]),
        "blend_file": np.array("a.blend"),
        "tolerance": np.array(1.5),
        "levels_1": np.zeros(5, np.uint8),
        "levels_2": np.zeros(5, np.uint8),
    }


@pytest.mark.parametrize("name", plan_file.FORM)
@pytest.mark.parametrize(
    "value",
    (
        np.array(b"x"),
        np.zeros((2, 3)),
        np.array([2, 1]),
        np.array([np.nan, 1.0]),
        np.zeros(0),
        np.array([b"a", b"b"]),
    ),
)
def test_a_plan_with_another_array_is_told_by_its_name(tmp_path, name, value):
    path = tmp_path / "plan.npz"
    np.savez(path, **(plan_arrays() | {name: value}))
    with pytest.raises(
        CrowdError, match="of another version" if name == "version" else f"spoilt in .*{name}"
    ):
        plan_file.read(path)


def test_a_sound_plan_is_read(tmp_path):
    path = tmp_path / "plan.npz"
    np.savez(path, **plan_arrays())
    plan = plan_file.read(path)
    assert plan.made_of == {"the crowd": "12"} and plan.row(1, 5).tolist() == [0] * 5
    with pytest.raises(CrowdError, match="does not have 6 agents in levels_2"):
        plan.row(1, 6)
