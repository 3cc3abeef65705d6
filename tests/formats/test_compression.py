"""Compressed files cannot write outside their folder, and cannot expand without limit."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from truing.formats import compression
from truing.formats.compression import Refused, open_plain

CONTENT = b"pose,body,target\n1,base,B1\n"


def _zip(name: str, content: bytes, *more: str) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, content)
        for other in more:
            archive.writestr(other, b"")
    return buffer.getvalue()


def _contents(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.rglob("*"))


@pytest.mark.parametrize("name", ["/etc/points.csv", "../../points.csv", "..\\points.csv", "C:\\points.csv", "a/b.csv"])
def test_the_name_inside_an_archive_leads_nowhere(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "a" / "b"
    folder.mkdir(parents=True)
    (folder / "p.zip").write_bytes(_zip(name, CONTENT))
    with open_plain(folder / "p.zip") as stream:
        assert stream.read() == CONTENT
    assert _contents(tmp_path) == ["a", "b", "p.zip"]


def test_resource_forks_of_macos_count_as_no_second_file(tmp_path: Path) -> None:
    (tmp_path / "p.zip").write_bytes(_zip("points.csv", CONTENT, "__MACOSX/._points.csv"))
    with open_plain(tmp_path / "p.zip") as stream:
        assert stream.read() == CONTENT


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (gzip.compress(gzip.compress(CONTENT, mtime=0), mtime=0), "one within another"),
        (gzip.compress(_zip("a.csv", CONTENT), mtime=0), "one within another"),
        (_zip("a.csv.xz", lzma.compress(CONTENT)), "one within another"),
        (_zip("[Content_Types].xml", b"<Types/>", "xl/workbook.xml"), "text, or a workbook that is saved as .xlsx"),
        (_zip("mimetype", b"application/vnd.oasis", "content.xml"), "text, or a workbook that is saved as .xlsx"),
        (b"\xd0\xcf\x11\xe0" + 100 * b"\0", "text, or a workbook that is saved as .xlsx"),
        (_zip("a.csv", CONTENT, "b.csv"), "a single file inside"),
        (b"PK\x05\x06" + b"\0" * 18, "a single file inside"),
    ],
)
def test_archives_within_archives_and_of_several_files_are_refused(tmp_path: Path, content: bytes, said: str) -> None:
    (tmp_path / "p").write_bytes(content)
    with pytest.raises(Refused, match=said), open_plain(tmp_path / "p"):
        pass


@pytest.mark.parametrize("at", [(6, 8), (8, 10)])
def test_an_archive_with_a_password_or_an_unknown_method_is_refused(tmp_path: Path, at: tuple[int, int]) -> None:
    """Offsets of flags and method in a member's own head; those of the archive's list stand two further."""
    content = bytearray(_zip("points.csv", CONTENT))
    listed = content.index(b"PK\x01\x02")
    value = struct.pack("<H", 1 if at[0] == 6 else 99)
    content[at[0] : at[1]] = value
    content[listed + at[0] + 2 : listed + at[1] + 2] = value
    (tmp_path / "p.zip").write_bytes(content)
    with pytest.raises(Refused, match="without password"), open_plain(tmp_path / "p.zip"):
        pass


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress, lzma.compress, lambda content: _zip("p.csv", content)])
def test_a_decompression_bomb_is_not_read_to_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pack: Callable[[bytes], bytes]
) -> None:
    monkeypatch.setattr(compression, "FREE", 1 << 20)
    (tmp_path / "p").write_bytes(pack(b"\n" * (8 << 20)))
    most = max(1 << 20, compression.LARGEST_RATIO * (tmp_path / "p").stat().st_size)
    with open_plain(tmp_path / "p") as stream, pytest.raises(Refused, match="may be a decompression bomb"):
        stream.read(most + 1)


def test_there_is_an_absolute_bound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compression, "LARGEST", len(CONTENT) - 1)
    (tmp_path / "p.csv.gz").write_bytes(gzip.compress(CONTENT))
    with pytest.raises(Refused), open_plain(tmp_path / "p.csv.gz"):
        pass
