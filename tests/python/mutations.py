"""Change bytes of a small valid file, again and again, and read it: its content or a sentence, nothing else.

Run by `test_io_mutations.py` as a program of its own, one for each format: a crash, a hang or a runaway
allocation would otherwise take the other tests along. Prints what it found as one line of JSON.

    python mutations.py FORMAT N_MUTATIONS SEED
"""

from __future__ import annotations

import faulthandler
import json
import logging
import random
import re
import struct
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from copc_files import write_copc
from mutated_documents import DOCUMENTS

import tmchho
from tmchho.cloud import PointCloud
from tmchho.io import read, write

MAX_SECONDS = 20  # for one file of a few kilobytes, on a busy machine
MAX_TIMES_FILE, MAX_EXTRA_BYTES = 10, 200 * 2**20
N_POINTS = 24
PAGE, CHECKSUM = 1024, 4


def small_cloud(n_scans: int = 1) -> PointCloud:
    rng = np.random.default_rng(0)
    xyz = np.array([500_000, 4_000_000, 100]) + rng.uniform(0, 10, (N_POINTS, 3)).round(3)
    attributes = {name: rng.integers(0, 255, N_POINTS, dtype=np.uint8) for name in ("red", "green", "blue")}
    attributes |= {"intensity": rng.uniform(0, 1, N_POINTS).round(3), "roughness": rng.random(N_POINTS)}
    if n_scans > 1:
        attributes["scan_index"] = (np.arange(N_POINTS) % n_scans).astype(np.uint16)
    return PointCloud(xyz, attributes)


def written(name: str, path: Path) -> None:
    write(small_cloud(), path / name)


def as_bytes(path: Path, name: str, data: bytes) -> None:
    (path / name).write_bytes(data)


def scans(name: str, path: Path) -> None:
    write(small_cloud(n_scans=2), path / name)


def ply(kind: str, path: Path) -> None:
    """Write a PLY by hand: elements before and after the vertices, a stray line in the header."""
    order = ">" if kind == "binary_big_endian" else "<"
    fields = [("x", "f8"), ("y", "f8"), ("z", "f8"), ("red", "u1")]
    rows = np.zeros(N_POINTS, dtype=[(name, order + field) for name, field in fields])
    for axis, values in zip("xyz", small_cloud().xyz.T, strict=True):
        rows[axis] = values
    header = (
        f"ply\nformat {kind} 1.0\nobj_info made by hand\nelement camera 1\nproperty int id\n"
        "property list uchar ushort parts\nbye\n"
        f"element vertex {N_POINTS}\nproperty double x\nproperty double y\nproperty double z\n"
        "property uchar red\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    if kind == "ascii":
        lines = [" ".join(map(str, row)) for row in [(7, 2, 5, 6), *rows.tolist(), (3, 0, 1, 2)]]
        body = "\n".join([*lines, ""]).encode()
    else:
        body = struct.pack(f"{order}iB2H", 7, 2, 5, 6) + rows.tobytes() + b"\3" + b"\0" * 12
    as_bytes(path, "a.ply", header.encode() + body)


def pcd(encoding: str, path: Path) -> None:
    """Write a PCD in one of its encodings; the packed one is ours, unpacked and packed again."""
    import lzf

    write(small_cloud(), path / "a.pcd")
    data = (path / "a.pcd").read_bytes()
    header, _, body = data.partition(b"DATA binary\n")
    if encoding == "binary":
        return
    columns = read(path / "a.pcd")
    if encoding == "ascii":
        header = re.sub(rb"(?m)^(FIELDS|SIZE|TYPE|COUNT).*$", b"", header)
        head = b"FIELDS x y z roughness\nSIZE 8 8 8 8\nTYPE F F F F\nCOUNT 1 1 1 1\n"
        table = np.column_stack([columns.xyz, columns.attributes["roughness"]])
        text = "".join(" ".join(map(str, row)) + "\n" for row in table.tolist())
        as_bytes(path, "a.pcd", head + header + b"DATA ascii\n" + text.encode())
    else:
        row_bytes = len(body) // N_POINTS
        sizes = [int(word) for word in re.search(rb"SIZE (.*)\n", header)[1].split()]  # type: ignore[index]
        rows = np.frombuffer(body, np.uint8).reshape(N_POINTS, row_bytes)
        parts = np.split(rows, np.cumsum(sizes)[:-1], axis=1)
        plain = b"".join(part.tobytes() for part in parts)
        packed = lzf.compress(plain, 2 * len(plain))
        sizes_of_both = len(packed).to_bytes(4, "little") + len(plain).to_bytes(4, "little")
        as_bytes(path, "a.pcd", header + b"DATA binary_compressed\n" + sizes_of_both + packed)


def obj(path: Path) -> None:
    lines = [f"v {x} {y} {z}\n" for x, y, z in small_cloud().xyz.tolist()]
    as_bytes(path, "a.obj", ("# mesh\no thing\n" + "".join(lines) + "f 1 2 3\n").encode())


def las(version: str, point_format: int, suffix: str, path: Path) -> None:
    import laspy

    header = laspy.LasHeader(version=version, point_format=point_format)
    header.scales, header.offsets = [0.001] * 3, [500_000, 4_000_000, 0]
    header.add_extra_dim(laspy.ExtraBytesParams("roughness", "f4"))
    points = laspy.LasData(header)
    points.x, points.y, points.z = small_cloud().xyz.T
    points.intensity = np.arange(N_POINTS)
    points.write(path / f"a{suffix}")


# What is to be read, by the name that the test gives: a file `a.*` in an empty folder.
MAKERS: dict[str, Callable[[Path], None]] = {
    "las": partial(las, "1.2", 3, ".las"),
    "las14": partial(las, "1.4", 7, ".las"),
    "laz": partial(las, "1.2", 3, ".laz"),
    "laz14": partial(las, "1.4", 7, ".laz"),
    "copc": lambda path: write_copc(path / "a.copc.laz", n_points=(4, 8, 16), further_page=True),
    "e57": partial(scans, "a.e57"),
    "ply_ascii": partial(ply, "ascii"),
    "ply_little": partial(ply, "binary_little_endian"),
    "ply_big": partial(ply, "binary_big_endian"),
    "pcd_ascii": partial(pcd, "ascii"),
    "pcd_binary": partial(pcd, "binary"),
    "pcd_compressed": partial(pcd, "binary_compressed"),
    "pts": partial(written, "a.pts"),
    "ptx": partial(scans, "a.ptx"),
    "xyz": partial(written, "a.xyz"),
    "csv": partial(written, "a.csv"),
    "npy": partial(written, "a.npy"),
    "npz": partial(written, "a.npz"),
    "obj": obj,
    **{name: maker for name, (maker, _) in DOCUMENTS.items()},
}

NUMBERS = (
    0,
    1,
    0x7F,
    0x80,
    0xFF,
    0x7FFF,
    0xFFFF,
    0x7FFFFFFF,
    0x80000000,
    0xFFFFFFFF,
    2**40,
    2**62,
    2**64 - 1,
)
WORDS = (
    b"-1",
    b"0",
    b"99999999999999999999",
    b"1e400",
    b"nan",
    b"\n",
    b" ",
    b",",
    b";",
    b"\t",
    b"#",
    b"\xff\xfe",
)


def mutated(data: bytes, choose: random.Random) -> bytes:
    """Return the bytes with one to four changes of the kinds that damage and malice make."""
    result = bytearray(data)
    for _ in range(choose.randint(1, 4)):
        at = choose.randrange(len(result)) if result else 0
        match choose.randrange(8):
            case 0:
                result[at : at + 1] = bytes([result[at] ^ (1 << choose.randrange(8))]) if result else b""
            case 1:
                result[at : at + 1] = choose.randbytes(1)
            case 2:
                n_bytes = choose.choice((1, 2, 4, 8))
                number = choose.choice(NUMBERS) % 2 ** (8 * n_bytes)
                result[at : at + n_bytes] = number.to_bytes(n_bytes, "little")
            case 3:
                del result[at : at + choose.choice((1, 2, 4, 30, 300))]
            case 4:
                length = choose.choice((1, 8, 100))
                result[at:at] = result[choose.randrange(len(result) + 1) :][:length]
            case 5:
                digits = [match.span() for match in re.finditer(rb"\d+", bytes(result[:4000]))]
                if digits:
                    start, end = choose.choice(digits)
                    result[start:end] = choose.choice(WORDS)
            case 6:
                result[at:at] = choose.choice(WORDS)
            case 7:
                if choose.random() < 0.2:
                    del result[at:]
                else:
                    result[at : at + 20] = choose.randbytes(20)
    return bytes(result)


def with_checksums(data: bytes) -> bytes:
    """Return the pages of an E57 file with checksums that fit, so that damage gets past them."""
    pages = [data[start : start + PAGE - CHECKSUM] for start in range(0, len(data) - PAGE + 1, PAGE)]
    return b"".join(page + crc32c(page).to_bytes(4, "big") for page in pages)


def crc32c(data: bytes) -> int:
    value = 0xFFFFFFFF
    for byte in data:
        value = TABLE[(value ^ byte) & 255] ^ (value >> 8)
    return value ^ 0xFFFFFFFF


def table_of_crc() -> list[int]:
    table = []
    for value in range(256):
        for _ in range(8):
            value = (value >> 1) ^ (0x82F63B78 if value & 1 else 0)
        table.append(value)
    return table


TABLE = table_of_crc()


def limit_memory(n_bytes: int) -> None:
    """Let the program have no more than what it has now and what a file of that size may cost."""
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[0])
    except (ImportError, OSError):
        return  # not Linux: the other checks remain
    limit = pages * resource.getpagesize() + MAX_TIMES_FILE * n_bytes + MAX_EXTRA_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


class Unheard(logging.Handler):
    """Puts messages together, which must not fail either, and keeps them to itself."""

    def emit(self, record: logging.LogRecord) -> None:
        self.format(record)


def options_of(name: str, choose: random.Random) -> dict[str, object]:
    """Return arguments for `read`: COPC files are also read in part."""
    if name != "copc" or choose.random() < 0.4:
        return {}
    box = [[499_990, 3_999_990, 0], [500_001, 4_000_004, 200]]
    return {"box": box, "resolution": choose.choice((None, 2.0, 0.5, 1e-300))}


def try_out(name: str, path: Path, choose: random.Random) -> None:
    """Read the file; what comes out must be of one piece."""
    if name in DOCUMENTS:
        DOCUMENTS[name][1](path)
        return
    cloud = read(path, **options_of(name, choose))  # type: ignore[arg-type]
    assert len(cloud) > 0
    assert all(len(values) == len(cloud) for values in cloud.attributes.values())


def main(name: str, n_mutations: int, seed: int) -> None:
    logging.basicConfig(handlers=[Unheard()], level=logging.INFO)
    choose = random.Random(f"{name} {seed}")
    with tempfile.TemporaryDirectory() as folder:
        MAKERS[name](Path(folder))
        (path,) = Path(folder).iterdir()
        valid = path.read_bytes()
        for seed_of_options in (0, 1):  # also loads all that is loaded late
            try_out(name, path, random.Random(seed_of_options))
        limit_memory(2 * len(valid))
        n_read, slowest, sentences = 0, 0.0, set[str]()
        for number in range(n_mutations):
            data = mutated(valid, choose)
            if name == "e57" and number % 4:
                data = with_checksums(data)
            path.write_bytes(data)
            faulthandler.dump_traceback_later(MAX_SECONDS, exit=True)
            start = time.perf_counter()
            try:
                try_out(name, path, choose)
                n_read += 1
            except (tmchho.errors.ReadError, tmchho.errors.InvalidArgumentError) as error:
                message = str(error)
                # Clouds name the file; documents a line or a key as well.
                assert message.startswith(f"{path}: ") or (name in DOCUMENTS and str(path) in message), (
                    message
                )
                assert name in DOCUMENTS or error.exit_code == tmchho.errors.ReadError.exit_code, message  # noqa: PT017
                assert "\n" not in message, message
                sentences.add(re.sub(r"[-\d.e+]+", "#", message.removeprefix(str(path)))[:60])
            except BaseException:
                keep = (
                    Path(tempfile.gettempdir()) / f"mutation_{name}_{seed}_{number}{''.join(path.suffixes)}"
                )
                keep.write_bytes(data)
                print(f"mutation {number} of {name} is kept as {keep}", file=sys.stderr)
                raise
            slowest = max(slowest, time.perf_counter() - start)
        faulthandler.cancel_dump_traceback_later()
    print(json.dumps({"n_read": n_read, "n_sentences": len(sentences), "slowest_s": slowest}))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
