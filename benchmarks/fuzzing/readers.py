"""Each reader with a file that it reads, and the checks of what it returns."""

import tempfile
import warnings
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fdcal import Calibration
from fdcal.acoustics.plane_waves import load_sdm_response
from fdcal.assessment.result_file import load_result, save_result
from fdcal.model.measurement import Measurement, load_measurement, save_measurement
from fdcal.model.scene import folder_of, load_scene
from fdcal.model.settings import Search, SolverSettings
from fdcal.model.validation import InputError
from fdcal.recordings import formats
from fdcal.recordings.formats.positions import read_places
from fdcal.recordings.recording import read_samples
from fdcal.session import session_file
from fdcal.session.lesson import load_lesson
from fdcal.session.sources import check_scene

from .mutations import broken, broken_structure


@dataclass(frozen=True)
class Reader:
    """A reader.

    Attributes
    ----------
    suffix : of its files
    make : writes a good file
    read : reads a file, and raises AssertionError for an invalid object
    apart : whether a C library reads it, so that a fault may end the process, or a separate process is started
    mutate : breaks the content of a file
    """

    suffix: str
    make: Callable[[Path], object]
    read: Callable[[Path], object]
    apart: bool = False
    mutate: Callable[[bytes, np.random.Generator], bytes] = broken


def measurement(count: int = 8, modes: int = 6) -> Measurement:
    """Return a small measurement with noise, positions, a search domain and a spectrum."""
    rng = np.random.default_rng(0)
    pressures = rng.normal(size=(modes, count)) + 1j * rng.normal(size=(modes, count))
    return Measurement(
        np.linspace(100.0, 300.0, modes), pressures, 343.0, noise_power=np.full(modes, 0.01),
        positions=rng.normal(size=(count, 2)), known=range(3), search=Search((-3.0, -3.0), (6.0, 6.0), 0.5, 1.0),
        spectrum=np.stack([np.arange(10.0), np.ones(10)]),
    )  # fmt: skip


def _make_session(path: Path) -> None:
    from fdcal import solvers
    from fdcal.model.scene import placeholder_scene
    from fdcal.session.sources import OpenRequest

    settings = SolverSettings(modes=6, name="descent", start="random", first_modes=2)
    own = measurement(count=24)
    scene = placeholder_scene(own, "fuzz", settings)
    state = solvers.load("descent").init(own.problem(), settings, 0)
    path.write_bytes(session_file.write(OpenRequest(scene, 0, own, (state, state), 0, {"mode": "1"})))


def _make_result(path: Path) -> None:
    rng = np.random.default_rng(0)
    save_result(
        Calibration(
            rng.normal(size=(5, 2)), tuple("abcde"), "joint", 0, np.arange(1.0, 7.0), 0.1, 3, 1.5, True, known=("a",),
            verdict="good", uncertainty=np.ones(5), covariance=np.ones((5, 2, 2)), sound_speed=343.0,
        ),
        path,
    )  # fmt: skip


def _finite(*arrays) -> None:
    assert all(np.isfinite(array).all() for array in arrays if array is not None), "numbers that are not finite"


def _read_measurement(path: Path) -> None:
    found = load_measurement(path)
    _finite(found.pressures, found.wavenumbers, found.positions, found.known_positions, found.noise_power)
    problem = found.problem()
    _finite(problem.pressures, problem.noise_power)


def _read_result(path: Path) -> None:
    found = load_result(path)
    _finite(found.positions, found.uncertainty, found.covariance)
    assert Calibration.from_json(found.to_json()).positions.tolist() == found.positions.tolist()


def _read_session(path: Path) -> None:
    found = session_file.read(path)
    for state in found.states:
        _finite(state.positions)


def _read_recording(path: Path) -> None:
    found = formats.read(path)
    assert found.count * found.samples < 10**6, "more samples than the file has bytes"
    _finite(read_samples(found, 0, found.samples), found.positions)


def _read_scene(path: Path) -> None:
    check_scene(load_scene(path))


def _read_table(path: Path) -> None:
    names, positions = read_places(path)
    assert len(names) == len(positions)
    _finite(positions)


SAMPLES = np.random.default_rng(0).uniform(-0.5, 0.5, (3, 200))


def _make_sound(path: Path) -> None:
    import soundfile

    soundfile.write(path, SAMPLES.T, 8000, format=path.suffix[1:].upper())


def _make_hdf5(path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file.create_dataset("time_data", data=SAMPLES.T).attrs["sample_freq"] = 8000.0


def _copy(source: Path) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(source.read_bytes())


def _make_meshrir(path: Path) -> None:
    """Write the files of a folder of MeshRIR into one archive, so that they can be broken like others."""
    rng = np.random.default_rng(0)
    arrays = {"pos_mic": rng.normal(size=(4, 3)), "pos_src": rng.normal(size=(2, 3))}
    np.savez(path, **arrays, **{f"ir_{n}": rng.normal(size=(2, 50)) for n in range(4)})


def _read_meshrir(path: Path) -> None:
    """Read a folder with the files of an archive; an archive that cannot be unpacked is no folder."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "mesh"
        place.mkdir()
        try:
            with zipfile.ZipFile(path) as archive:
                for name in archive.namelist():
                    (place / Path(name).name).write_bytes(archive.read(name))
        except Exception as error:
            raise InputError(f"{path.name} is no archive", "mend it") from error
        _read_recording(place)


def _make_sdm(path: Path) -> None:
    from scipy.io import savemat

    rng, samples = np.random.default_rng(0), 200
    pressure = rng.normal(size=samples) * np.exp(-np.arange(samples) / 20)
    angles = {"azi_rad": rng.uniform(-3, 3, samples), "ele_rad": rng.uniform(-1.5, 1.5, samples)}
    savemat(path, {"p": pressure, **angles, "fs": 48000.0})


def _read_sdm(path: Path) -> None:
    found = load_sdm_response(path)
    _finite(found.amplitudes, found.directions, found.times)
    assert len(found.amplitudes) == len(found.directions) and found.sample_rate > 0


def _make_sofa(path: Path) -> None:
    import sofar

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sofa = sofar.Sofa("GeneralFIR")
        sofa.Data_IR, sofa.Data_SamplingRate = SAMPLES[None], 8000.0
        sofa.Data_Delay = np.zeros((1, len(SAMPLES)))
        sofa.ReceiverPosition = np.random.default_rng(1).uniform(-1, 1, (len(SAMPLES), 3))
        sofa.ReceiverPosition_Type = "cartesian"
        sofar.write_sofa(str(path), sofa)


def _make_geometry(path: Path) -> None:
    microphones = "".join(f'<pos Name="m{n}" x="{n / 10}" y="-1e-1" z="0.5"/>\n' for n in range(5))
    path.write_text(f'<?xml version="1.0" encoding="utf-8"?>\n<MicArray name="fuzz">\n{microphones}</MicArray>\n')


def _read_geometry(path: Path) -> None:
    names, positions = read_places(path)
    assert len(names) == len(set(names)) == len(positions)
    _finite(positions)


def _make_recordings(path: Path) -> None:
    np.savez(path, recordings=SAMPLES, sample_rate=8000.0, names=np.array(list("abc")), kind="impulse")


def _make_matlab(path: Path) -> None:
    from scipy.io import savemat

    savemat(path, {"x": SAMPLES, "fs": 8000.0})


def _make_samples(path: Path) -> None:
    rows = np.column_stack([np.arange(SAMPLES.shape[1]) / 8000, SAMPLES.T])
    np.savetxt(path, rows, delimiter=",", header="time,a,b,c", comments="")


def _make_piped(path: Path) -> None:
    _make_sound(path)
    path.write_bytes(path.read_bytes().replace(b"data", b"data\0\0\0\0", 1)[:-4])


READERS = {
    "scene": Reader(".toml", _copy(folder_of("scenes") / "tiny.toml"), _read_scene),
    "scene in space": Reader(".toml", _copy(folder_of("scenes") / "ball3d.toml"), _read_scene),
    "lesson": Reader(".toml", _copy(sorted(folder_of("lessons").glob("*.toml"))[0]), load_lesson),
    "measurement": Reader(".npz", lambda path: save_measurement(measurement(), path), _read_measurement),
    "result": Reader(".json", _make_result, _read_result),
    "session": Reader(".zip", _make_session, _read_session),
    "table": Reader(".csv", lambda path: path.write_text("name,x,y,z\na,1,2,3\nb,0.5,1e-1,-2\n"), _read_table),
    "archive": Reader(".npz", _make_recordings, _read_recording),
    **{name: Reader(f".{name}", _make_sound, _read_recording)
       for name in ("wav", "flac", "w64", "rf64", "aiff", "au", "caf")},
    "matlab": Reader(".mat", _make_matlab, _read_recording, apart=True),
    "samples": Reader(".csv", _make_samples, _read_recording),
    "piped": Reader(".wav", _make_piped, _read_recording),
    "hdf5": Reader(".h5", _make_hdf5, _read_recording, mutate=broken_structure, apart=True),
    "sofa": Reader(".sofa", _make_sofa, _read_recording, mutate=broken_structure, apart=True),
    "meshrir": Reader(".npz", _make_meshrir, _read_meshrir),
    "sdm": Reader(".mat", _make_sdm, _read_sdm, apart=True),
    "geometry": Reader(".xml", _make_geometry, _read_geometry),
}  # fmt: skip
