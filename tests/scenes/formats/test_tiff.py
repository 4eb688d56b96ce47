import numpy as np
import pytest
import tifffile
from PIL import Image, TiffImagePlugin

from tdgbench.scenes import SceneError
from tdgbench.scenes.formats import decode, header, read_celsius
from tdgbench.scenes.temperature import CountScale

Y, X = np.mgrid[0:24, 0:32]
CELSIUS = (10 + X / 2 + Y / 3).astype(np.float32)
KELVIN = np.round((CELSIUS + 273.15) * 100).astype(np.uint16)


def test_tiff(tmp_path):
    Image.fromarray(CELSIUS.astype(np.float32)).save(tmp_path / "float.tiff")
    assert np.allclose(read_celsius(tmp_path / "float.tiff"), CELSIUS, atol=1e-5)
    counts = np.round((CELSIUS.astype(float) + 100) * 40).astype(np.uint16)
    for name in ("counts.tiff", "counts.png"):
        Image.fromarray(counts).save(tmp_path / name)
        assert np.allclose(read_celsius(tmp_path / name, CountScale(1 / 40, -100)), counts / 40 - 100, atol=1e-9)
        with pytest.raises(SceneError, match="degC_per_count"):
            read_celsius(tmp_path / name)


def test_values_that_are_no_temperature_are_nan(tmp_path):
    degC = CELSIUS.copy()
    degC[0, :3] = np.nan, np.inf, -300
    tifffile.imwrite(tmp_path / "t.tiff", degC)
    assert np.isnan(read_celsius(tmp_path / "t.tiff"))[0].tolist() == [True] * 3 + [False] * 29
    tifffile.imwrite(tmp_path / "none.tiff", np.full((4, 4), np.nan, np.float32))
    with pytest.raises(SceneError, match=r"none\.tiff holds no temperature"):
        read_celsius(tmp_path / "none.tiff")


@pytest.mark.parametrize(
    "written",
    [
        {"data": CELSIUS.astype(np.float64)},
        {"data": CELSIUS.astype(np.float16)},
        {"data": CELSIUS, "bigtiff": True},
        {"data": CELSIUS, "byteorder": ">"},
        {"data": CELSIUS, "compression": "lzw", "predictor": True},
        {"data": CELSIUS, "compression": "zlib", "tile": (16, 16)},
        {"data": CELSIUS, "compression": "zstd", "rowsperstrip": 5},
        {"data": CELSIUS[None], "photometric": "minisblack"},
        {"data": CELSIUS, "photometric": "miniswhite"},  # a hint for viewers
    ],
    ids=lambda written: " ".join(map(str, [written["data"].dtype, *list(written)[1:]])),
)
def test_depths_and_ways_of_storage(tmp_path, written):
    tifffile.imwrite(tmp_path / "t.tif", written.pop("data"), **written)
    assert header(tmp_path / "t.tif")[1:5] == (32, 24, "float", "°C")
    decoded = decode(tmp_path / "t.tif")
    assert decoded.valid is None and np.allclose(decoded.values[..., 0], CELSIUS, atol=0.02)
    assert np.array_equal(decoded.values[..., 0], tifffile.imread(tmp_path / "t.tif").reshape(24, 32))


def test_counts_of_several_channels_keep_their_bits(tmp_path):
    opaque = np.full_like(KELVIN, 65535)
    opaque[:3] = 0
    for channels, photometric, extra in (
        ([KELVIN] * 3, "rgb", None), ([KELVIN, opaque], "minisblack", ["unassalpha"]),
        ([KELVIN] * 3 + [opaque], "rgb", ["unassalpha"]),
    ):  # fmt: skip
        for planar in ("contig", "separate"):
            data = np.stack(channels, axis=-1 if planar == "contig" else 0)
            tifffile.imwrite(tmp_path / "t.tif", data, photometric=photometric, planarconfig=planar, extrasamples=extra)
            decoded = decode(tmp_path / "t.tif")
            assert all(np.array_equal(decoded.values[..., c], KELVIN) for c in range(decoded.values.shape[2]))
            assert decoded.header.meaning == "counts"
            assert (decoded.valid is None) if extra is None else np.array_equal(decoded.valid, opaque > 0)


@pytest.mark.parametrize("dtype", [np.int16, np.int32, np.uint32])
def test_other_integers(tmp_path, dtype):
    counts = np.round(CELSIUS * 10).astype(dtype) - dtype(200 * (dtype is not np.uint32))
    tifffile.imwrite(tmp_path / "t.tif", counts)
    assert np.array_equal(decode(tmp_path / "t.tif").values[..., 0], counts)
    assert np.allclose(read_celsius(tmp_path / "t.tif", CountScale(0.1, 5)), counts.astype(float) / 10 + 5)
    tifffile.imwrite(tmp_path / "large.tif", np.array([[1, 2**24 + 1]], np.int32))
    with pytest.raises(SceneError, match=r"large\.tif has counts beyond ±16777216"):
        decode(tmp_path / "large.tif")


@pytest.mark.parametrize("thumbnail_first", [True, False])
def test_the_full_page_is_the_image(tmp_path, thumbnail_first):
    pages = [np.zeros((6, 8), np.uint8), KELVIN] if thumbnail_first else [KELVIN, np.zeros((6, 8), np.uint8)]
    with tifffile.TiffWriter(tmp_path / "t.tif") as writer:
        for page in pages:
            writer.write(page)
    assert np.array_equal(decode(tmp_path / "t.tif").values[..., 0], KELVIN)
    assert header(tmp_path / "t.tif")[1:3] == (32, 24)
    with tifffile.TiffWriter(tmp_path / "sub.tif") as writer:
        writer.write(np.zeros((6, 8), np.uint8), subifds=1)
        writer.write(KELVIN)
    assert np.array_equal(decode(tmp_path / "sub.tif").values[..., 0], KELVIN)


def test_a_page_may_mask_the_image(tmp_path):
    shown = CELSIUS > 15
    with tifffile.TiffWriter(tmp_path / "t.tif") as writer:
        writer.write(CELSIUS)
        writer.write(shown, subfiletype=4, photometric="minisblack")
    assert np.array_equal(np.isfinite(read_celsius(tmp_path / "t.tif")), shown)


@pytest.mark.parametrize(("nodata", "dtype"), [("-9999", np.float32), ("nan", np.float32), ("0", np.uint16)])
def test_pixels_without_data(tmp_path, nodata, dtype):
    values = (CELSIUS if dtype == np.float32 else KELVIN).copy()
    values[:, :5] = float(nodata)
    tifffile.imwrite(tmp_path / "t.tif", values, extratags=[(42113, 2, 0, nodata, True)])
    assert np.array_equal(~decode(tmp_path / "t.tif").valid, X < 5)


@pytest.mark.parametrize(("nodata", "dtype"), [("-9999", np.uint16), ("3.4e38", np.uint16), ("-1.797e308", np.float32)])
def test_a_value_for_no_data_that_no_pixel_can_have(tmp_path, nodata, dtype):
    values = (CELSIUS if dtype == np.float32 else KELVIN).copy()
    tifffile.imwrite(tmp_path / "t.tif", values, extratags=[(42113, 2, 0, nodata, True)])
    assert decode(tmp_path / "t.tif").valid.all()


def item(role, text):
    """Tag 42112 with a line of GDAL's metadata."""
    return {"extratags": [(42112, 2, 0, f'<Item name="S" sample="0" role="{role}">{text}</Item>'.encode(), True)]}


@pytest.mark.parametrize("unit", ["°C", "℃", "degC", "deg C", "Celsius", "degrees Celsius", "Cel", ""])
def test_floats_in_celsius_by_their_unit(tmp_path, unit):
    tifffile.imwrite(tmp_path / "t.tif", CELSIUS, **item("unittype", unit))
    assert np.array_equal(decode(tmp_path / "t.tif").values[..., 0], CELSIUS)


@pytest.mark.parametrize("bits", [2, 4, 12])
def test_samples_that_do_not_fill_their_type(tmp_path, bits):
    tifffile.imwrite(
        tmp_path / "t.tif", np.zeros((8, 8), np.uint16 if bits > 8 else np.uint8), photometric="minisblack"
    )
    with tifffile.TiffFile(tmp_path / "t.tif", mode="r+") as tiff:
        tiff.pages[0].tags["BitsPerSample"].overwrite(bits)
    with pytest.raises(SceneError, match=rf"t\.tif has pixels of {bits} bits in a form that is not read; export it"):
        header(tmp_path / "t.tif")


@pytest.mark.parametrize(
    ("written", "message"),
    [
        ({"data": np.stack([CELSIUS, CELSIUS]), "planarconfig": "separate", "photometric": "minisblack"}, "2 bands of"),
        ({"data": np.stack([CELSIUS] * 3, -1), "photometric": "rgb"}, "3 bands of float values"),
        ({"data": np.stack([CELSIUS] * 2)}, "holds 2 pictures"),
        ({"data": CELSIUS, "description": "ImageJ=1.11a\nimages=3\n", "metadata": None}, "holds 3 pictures"),
        ({"data": KELVIN.astype(np.complex64)}, "in a form that is not read"),
        ({"data": KELVIN.astype(np.int8)}, "in a form that is not read"),
        ({"data": KELVIN, "photometric": "cfa", "extratags": []}, "16-bit pixels of .*CFA"),
        ({"data": KELVIN, **item("scale", 0.01)}, "are scaled"),
        ({"data": np.uint8(X), **item("offset", -10)}, "are scaled"),
        ({"data": CELSIUS, **item("unittype", "K")}, "its unit is K; export it as float TIFF in °C"),
        ({"data": CELSIUS, **item("unittype", "°F")}, "its unit is °F;"),
        ({"data": CELSIUS, **item("unittype", "0.1 °C")}, "its unit is 0.1 °C;"),
    ],
)  # fmt: skip
def test_what_is_not_read_is_named(tmp_path, written, message):
    tifffile.imwrite(tmp_path / "t.tif", written.pop("data"), **written)
    with pytest.raises(SceneError, match=rf"t\.tif .*{message}"):
        decode(tmp_path / "t.tif")


def test_pictures_of_8_bits(tmp_path):
    levels = np.uint8(X * 7)
    for photometric, expected in (("minisblack", levels), ("miniswhite", 255 - levels)):
        tifffile.imwrite(tmp_path / "t.tif", levels, photometric=photometric)
        assert np.array_equal(decode(tmp_path / "t.tif").values[..., 0], expected)
    tifffile.imwrite(tmp_path / "bits.tif", levels > 100, photometric="minisblack")
    assert np.array_equal(decode(tmp_path / "bits.tif").values[..., 0], 255 * (levels > 100))
    rgb = np.stack([levels, levels // 2, 255 - levels], -1)
    Image.fromarray(rgb).save(tmp_path / "jpeg.tif", compression="jpeg", quality=95)
    with Image.open(tmp_path / "jpeg.tif") as image:
        assert np.array_equal(decode(tmp_path / "jpeg.tif").values, np.asarray(image.convert("RGB")))
    Image.fromarray(rgb).quantize(32).save(tmp_path / "palette.tif")
    with Image.open(tmp_path / "palette.tif") as image:
        assert np.array_equal(decode(tmp_path / "palette.tif").values, np.asarray(image.convert("RGB")))


def with_gain(path, text):
    """A TIFF of counts with FLIR's XMP, as the Vue Pro writes it: the description's start tag is not closed."""
    directory = TiffImagePlugin.ImageFileDirectory_v2()
    directory[700] = f'<rdf:Description xmlns:FLIR="http://ns.flir.com/xmp/1.0/"\r\n<Camera:{text}'.encode()
    Image.fromarray(np.full((4, 5), 7300, np.uint16)).save(path, tiffinfo=directory)
    return path


@pytest.mark.parametrize(
    ("text", "given", "degC"),
    [
        ("TlinearGain>0.04</Camera:TlinearGain>", CountScale(), 7300 * 0.04 - 273.15),
        ('x FLIR:TlinearGain="0.01"', CountScale(0.01, -273.15), 7300 * 0.01 - 273.15),
        ("TlinearGain>0.00</Camera:TlinearGain>", CountScale(0.002, 1), 15.6),  # TLinear is off
        ("TlinearGain>0.1</Camera:TlinearGain>", CountScale(0.002, 1), 15.6),
        ("BandName>LWIR", CountScale(0.002, 1), 15.6),
    ],
)
def test_counts_mean_what_the_file_states(tmp_path, text, given, degC):
    assert np.allclose(read_celsius(with_gain(tmp_path / "a.tiff", text), given), degC)


@pytest.mark.parametrize(
    ("gain", "given", "what"),
    [
        ("0.00", CountScale(), "a.tiff holds counts; say which temperature"),
        ("0.1", CountScale(), "a.tiff states TlinearGain 0.1, .*manuals do not name: say degC_per_count"),
        ("0.04", CountScale(0.4, -273.15), "a.tiff states TlinearGain 0.04, .*: leave out degC_per_count"),
    ],
)
def test_no_gain_is_guessed(tmp_path, gain, given, what):
    with pytest.raises(SceneError, match=what):
        read_celsius(with_gain(tmp_path / "a.tiff", f"TlinearGain>{gain}<"), given)
