"""Would catch a format not recognized by its first bytes, or a file of the wrong type refused without its name."""

import gzip

import numpy as np
import pytest
from netCDF4 import Dataset
from scipy.io import savemat

from compasslib.errors import InputError
from compasslib.readers import read
from compasslib.readers.detect import detect_kind
from tests.world import pd0_encoder
from tests.world.sea import real

TABLE = b"t,u,v\n2007-09-04,1,2\n2007-09-05,3,4\n"
WRITTEN = [
    (b"\xa5\x0a\xa0\x10" + bytes(range(60)), "a Nortek file"),
    (b"\xa5\x05\x18\x00AQD 9330" + bytes(40), "a Nortek file"),
    (b"n\x7f\x02\x01" + bytes(range(60)), "an RDI PD12 file"),
    (b"7F7F940200061200" * 9, "a binary file written as hexadecimal text; turn the digits alone"),
    (b"2013/07/24 01:26:16.123 " + b"a50518004151" * 9, "a binary file written as hexadecimal text"),
    (b"PK\x03\x04" + bytes(60) + b"xl/workbook.xml", "a file of Office (Excel, Word)"),
    (b"PK\x03\x04" + bytes(60) + b"top.000", "a packed file"),
    (gzip.compress(b"\x7f\x7f\xae\x02\x00\x06" * 9), "a gzip file that holds an RDI PD0 file"),
    (b"%PDF-1.7\n" + bytes(90), "an image or a document"),
    (b"<!DOCTYPE html>\n<html><body>404</body></html>\n", "an image or a document"),
    (b"SQLite format 3\0" + bytes(90), "a database"),
    (b"* Sea-Bird SBE 37 Data File:\n* FileName = a.cnv\n*END*\n 1 2\n", "a Sea-Bird file"),
    (b"$HCHDG,9.0,,,10,E*2B\r\n" * 9, "an NMEA 0183 log"),
    (b" Format                 IAGA-2002                                   |\n" * 9, "an IAGA-2002 file"),
    (b"MATLAB 5.0 MAT-file, Platform: GLNXA64" + bytes(200), "a MATLAB file; write format: mat"),
    (b"Broadband 307.2 kHz\nPings/Ens = 45\nTime/Ping = 00:01.00\n", "a text export of RDI's programs"),
    (b"This is a letter about a mooring.\n" * 30, "a text without columns"),
    (b"$PNORS,011626,010336,00000000,3EC40002,23.7*7B\r\n" * 9, "telemetry of a Nortek instrument"),
    (
        b"*2006/07/14 09:34:44.28\n*IOS HEADER VERSION 2.0\n*FILE\n" * 3,
        "an IOS shell file; write format: table",
    ),
    (b"ODF_HEADER,\n FILE_SPECIFICATION='x',\n" * 9, "an ODF file; write format: table, skip_rows"),
    (b"[C:\\1121AQ04.PRF]\r\nNumber of measurements 9580\r\n" * 9, "a header file of Nortek's conversion"),
    (b"1407E0CA25148133715G38-0NN003EN101550 \r\n\r\n_w~@A@@FD`AM@Hx@" * 9, "RDI PD15 ensembles"),
    (b"\0" * 5000, "a file of nothing but zeros"),
    (b"version https://git-lfs.github.com/spec/v1\noid sha256:edfd\nsize 162027\n", "a pointer of Git LFS"),
    (b"../../.git/annex/objects/k8/XX/SHA256E-s1.000\n", "a pointer of Git LFS or git-annex"),
    (TABLE, "a text table"),
]


@pytest.mark.parametrize(("content", "name"), WRITTEN, ids=[name for _, name in WRITTEN])
def test_file_of_wrong_type_is_named_in_one_line(tmp_path, content, name):
    path = tmp_path / "top.000"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read("pd0", [path], {})
    line = str(caught.value)
    assert line.startswith(f"{path}: expected an RDI PD0 file, found {name}") and "\n" not in line and "; " in line


def test_files_written_by_libraries_are_recognized(tmp_path):
    Dataset(tmp_path / "a.nc", "w").close()
    Dataset(tmp_path / "b.nc", "w", format="NETCDF3_CLASSIC").close()
    savemat(tmp_path / "c.mat", {"u": np.zeros(3)})
    named = [detect_kind(tmp_path / name).name for name in ("a.nc", "b.nc", "c.mat")]
    assert named == ["a netCDF-4 or HDF5 file", "a netCDF file", "a MATLAB file"]


@pytest.mark.parametrize(
    "junk",
    [
        bytes([0, 0, 181, 0, 0, 166]),
        b"[BREAK Wakeup A]\r\nWorkHorse Broadband ADCP Version 16.30\r\n>CS\r\n",
        b"\x7f\x7f\x10\x00n\x7f\xa5\x05\x18\0DATA" * 30,
        bytes(70_000),
    ],
    ids=["six bytes", "banner", "marks of records", "zeros"],
)
def test_ensembles_are_recognized_behind_other_bytes(tmp_path, junk):
    path = tmp_path / "x"
    path.write_bytes(junk + pd0_encoder.ensemble([[100, 200, 3, 2]] * 4))
    assert detect_kind(path).form == "pd0"
    path.write_bytes(junk + pd0_encoder.ensemble([[100, 200, 3, 2]] * 4)[:-1])
    assert detect_kind(path) is None or detect_kind(path).form != "pd0"


PREAMBLE = "A line about the instrument\n" * 8 + "time,u,v\n"


@pytest.mark.parametrize(
    "content",
    [
        (TABLE * 9).decode().encode("utf-16"),
        *((PREAMBLE + 12 * row).encode() for row in ("Sep 04 2007 12:00,1.0,2.0\n", "'2007-09-04',1.0,2.0\n",
                                                     "M1;04.09.2007 12:00;1,0;2,0\n")),
    ],
)  # fmt: skip
def test_table_is_recognized_in_utf_16_and_below_a_preamble(tmp_path, content):
    (tmp_path / "x").write_bytes(content)
    assert detect_kind(tmp_path / "x").form == "table"


GENUINE = {
    "pd0/eh2_20060530_20060717_0007m.000": "pd0",
    "moored/aqd9330.aqd": "nortek",
    "moored/papa_node59p1.dat": "pd12",
    "acm/mmp_global_A0000001.DAT": "mmp_acm",
    "acm/mmp_global_A0000001.TXT": "mmp_acm",
    "swing/2010-11-03.Taiohae.nmea": "nmea0183",
    "observatory/esk20031029dmin.min": "iaga2002",
    "magnetometer/signature500.csv": "table",
}


@pytest.mark.parametrize("name", GENUINE)
def test_genuine_files_are_recognized(name):
    assert detect_kind(real(name)).form == GENUINE[name]
