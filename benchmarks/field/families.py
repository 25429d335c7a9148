"""Families of cases: lists of specs, each fixed by its seed. `FAMILIES` has them by name."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fdcal_bench.draw import Scenario

from .cases import calibration_study
from .spec import Spec

FAMILIES: dict[str, Callable[[int], list[Spec]]] = {}


def family(most: int):
    """Register a function of the number of cases, `most` at most, that returns keyword arguments of `Spec`."""

    def register(draw: Callable[[int], list[dict]]) -> Callable[[int], list[dict]]:
        FAMILIES[draw.__name__] = lambda count: [_spec(table) for table in draw(most)[:count]]
        return draw

    return register


def _spec(table: dict) -> Spec:
    return Spec(**{key: tuple(value) if isinstance(value, list) else value for key, value in table.items()})


GEO2 = ["circle", "grid", "disc", "clusters", "elongated", "spiral", "outlier"]
GEO3 = ["ball", "sphere", "cube", "shell", "slab"]


@family(70)
def clean2d(n):
    """Random draws in the plane at 30 to 60 dB."""
    out = []
    for i in range(n):
        r = np.random.default_rng([900, 1, i])
        out.append(
            dict(
                seed=51000 + i,
                geometry=GEO2[i % 7],
                count=int(r.integers(16, 66)),
                size=float(np.round(r.choice([0.25, 0.4, 0.6, 0.8, 1.2, 1.8]), 2)),
                modes=int(r.integers(18, 80)),
                highest=float(r.choice([200, 300, 450])),
                snr=[60.0, 40.0, 30.0][int(r.integers(3))],
                noise=["reported", "unknown"][int(r.integers(2))],
                known=int(r.integers(3, 7)),
                known_mode=["all", "all", "none", "minimal"][int(r.integers(4))],
                decay=float(r.choice([1.0, 3.0, 10.0, 25.0])),
                frequencies=["peaks", "peaks", "grid"][int(r.integers(3))],
            )
        )
    return out


@family(40)
def noisy2d(n):
    """5 to 20 dB in the plane."""
    out = []
    for i in range(n):
        r = np.random.default_rng([900, 2, i])
        out.append(
            dict(
                seed=52000 + i,
                geometry=GEO2[i % 7],
                count=int(r.integers(16, 66)),
                size=float(r.choice([0.4, 0.8, 1.2, 1.8])),
                modes=int(r.integers(24, 80)),
                highest=float(r.choice([200, 300, 450])),
                snr=[20.0, 15.0, 10.0, 5.0][int(r.integers(4))],
                noise=["reported", "unknown", "floor"][int(r.integers(3))],
                known=int(r.integers(3, 7)),
                known_mode=["all", "none"][int(r.integers(2))],
                decay=float(r.choice([1.0, 3.0, 10.0])),
                frequencies="peaks",
            )
        )
    return out


@family(30)
def small2d(n):
    """Few microphones, few frequencies."""
    out = []
    for i in range(n):
        r = np.random.default_rng([900, 3, i])
        out.append(
            dict(
                seed=53000 + i,
                geometry=["circle", "disc", "grid", "elongated"][i % 4],
                count=int(r.choice([6, 8, 10, 12, 14])),
                size=float(r.choice([0.3, 0.6, 1.0])),
                modes=int(r.choice([6, 8, 12, 16, 24, 40])),
                highest=350.0,
                snr=[60.0, 40.0, 30.0, 20.0][int(r.integers(4))],
                noise=["reported", "unknown"][int(r.integers(2))],
                known=int(r.integers(3, 5)),
                known_mode=["all", "all", "none"][int(r.integers(3))],
                decay=3.0,
                frequencies=["peaks", "grid"][int(r.integers(2))],
            )
        )
    return out


@family(24)
def big2d(n):
    """Arrays of 2 to 3 m that span most of a room, many wavelengths."""
    out = []
    for i in range(n):
        r = np.random.default_rng([900, 4, i])
        out.append(
            dict(
                seed=54000 + i,
                geometry=["disc", "grid", "clusters", "elongated", "outlier", "circle"][i % 6],
                count=int(r.integers(30, 81)),
                size=float(r.choice([2.0, 2.5, 3.0])),
                modes=int(r.integers(30, 70)),
                highest=float(r.choice([200, 350, 500])),
                snr=[60.0, 40.0, 30.0][int(r.integers(3))],
                noise=["reported", "unknown"][int(r.integers(2))],
                known=int(r.integers(3, 8)),
                known_mode=["all", "all", "none"][int(r.integers(3))],
                decay=3.0,
                frequencies="peaks",
                size_of_room=[4.2, 3.9] if i % 3 == 0 else None,
            )
        )
    return out


@family(12)
def line2d(n):
    """Arrays along a line, with a little depth."""
    return [
        dict(
            seed=55000 + i,
            geometry="line",
            count=[20, 30, 40][i % 3],
            size=[0.6, 1.2][i % 2],
            modes=50,
            highest=350.0,
            snr=[60.0, 40.0, 30.0][i % 3],
            noise=["reported", "unknown"][i // 2 % 2],
            known=[3, 4, 5][i % 3],
            known_mode=["all", "none", "all", "minimal"][i % 4],
        )
        for i in range(n)
    ]


@family(30)
def fem2d(n):
    """Rooms of other shapes, by finite elements."""
    out = []
    for i in range(n):
        r = np.random.default_rng([900, 6, i])
        out.append(
            dict(
                seed=56000 + i,
                room=["L", "U"][i % 2],
                geometry=GEO2[i % 7],
                count=int(r.integers(20, 60)),
                size=float(r.choice([0.4, 0.8, 1.2, 1.6])),
                modes=int(r.integers(24, 58)),
                highest=330.0,
                snr=[60.0, 40.0, 30.0, 20.0][int(r.integers(4))],
                noise=["reported", "unknown"][int(r.integers(2))],
                known=int(r.integers(3, 6)),
                known_mode=["all", "none"][int(r.integers(2))],
            )
        )
    return out


def _base(i, r, seed) -> dict:
    return dict(
        seed=seed + i,
        geometry=["disc", "circle", "grid", "spiral", "elongated"][i % 5],
        count=int(r.choice([24, 36, 50])),
        size=float(r.choice([0.5, 0.8, 1.2])),
        modes=int(r.choice([30, 45, 57])),
        highest=300.0,
        snr=[40.0, 30.0][int(r.integers(2))],
        noise=["reported", "unknown"][int(r.integers(2))],
        known=int(r.choice([4, 5, 6])),
    )


@family(32)
def knownfault(n):
    """Wrong given positions, and swapped channels."""
    out = []
    F = [
        ["known_error", 0.01],
        ["known_error", 0.05],
        ["known_swap", 0],
        ["channel_swap", 0],
        ["known_error_all", 0.005],
        ["known_error_all", 0.02],
        ["known_error", 0.2],
        ["known_error", 0.02],
    ]
    for i in range(n):
        r = np.random.default_rng([900, 7, i])
        s = _base(i, r, 57000)
        s["fault"] = F[i % 8]
        if i // 8 == 1:
            s["known"] = 3
        out.append(s)
    return out


@family(40)
def channels(n):
    """Faults of channels, and mismatch between them."""
    out = []
    F = [
        ["polarity", 0],
        ["dead", 1.0],
        ["dead", 0.01],
        ["gain", 0.5],
        ["gain", 1.0],
        ["gain", 3.0],
        ["gain_one", 3.0],
        ["phase", 5.0],
        ["delay", 3e-4],
        ["polarity", 1],
    ]
    for i in range(n):
        r = np.random.default_rng([900, 8, i])
        s = _base(i, r, 58000)
        s["fault"] = F[i % 10]
        if r.random() < 0.35:
            s["known_mode"] = "none"
        if s["fault"] == ["polarity", 1]:
            s["known_mode"] = "all"
        out.append(s)
    return out


@family(32)
def global2d(n):
    """Faults of all channels: sound speed, wavenumbers, wrongly reported noise, common hum, drift."""
    out = []
    F = [
        ["sound_speed", 0.01],
        ["sound_speed", 0.03],
        ["sound_speed", -0.03],
        ["no_wavenumbers", 0],
        ["wrong_noise", 10],
        ["wrong_noise", -10],
        ["hum", -20],
        ["drift", 0.01],
    ]
    for i in range(n):
        r = np.random.default_rng([900, 9, i])
        s = _base(i, r, 59000)
        s["fault"] = F[i % 8]
        if s["fault"][0] == "no_wavenumbers":
            s["decay"] = [3.0, 10.0, 25.0, 50.0][i // 8 % 4]
        if r.random() < 0.3:
            s["known_mode"] = "none"
        out.append(s)
    return out


@family(32)
def source2d(n):
    """A source 0.3 m from a microphone or inside the array, two sources, a scatterer inside, strong damping."""
    out = []
    for i in range(n):
        r = np.random.default_rng([900, 10, i])
        s = _base(i, r, 510000)
        k = i % 8
        s["snr"] = [60.0, 40.0, 30.0][i // 8 % 3]
        if k in (0, 1):
            s["source"] = "near"
        if k in (2, 3):
            s["source"] = "inside"
        if k == 4:
            s["source"] = "two"
        if k == 5:
            s["scatterer"] = [0.05, 0.3]
            s["scatterer_offset"] = 0.3
        if k == 6:
            s["scatterer"] = [0.12, 0.3]
            s["scatterer_offset"] = 0.2
        if k == 7:
            s["decay"] = [50.0, 100.0, 200.0, 80.0][i // 8]
            s["frequencies"] = "grid"
        if r.random() < 0.3:
            s["known_mode"] = "none"
        out.append(s)
    return out


@family(40)
def clean3d(n):
    """Random draws in space."""
    out = []
    for i in range(n):
        r = np.random.default_rng([900, 11, i])
        out.append(
            dict(
                seed=511000 + i,
                dimension=3,
                room="pyroomacoustics" if i % 5 == 4 else "box",
                geometry=(GEO3 + ["plane"])[i % 6],
                count=int(r.choice([24, 32, 48, 64])),
                size=float(r.choice([0.3, 0.6, 0.9, 1.2])),
                modes=int(r.choice([30, 45, 60, 79])),
                highest=float(r.choice([300, 450])),
                snr=[60.0, 40.0, 30.0, 20.0][int(r.integers(4))],
                noise=["reported", "unknown"][int(r.integers(2))],
                known=int(r.integers(4, 8)),
                known_mode=["all", "all", "none", "minimal"][int(r.integers(4))],
                frequencies=["peaks", "grid"][int(r.integers(2))],
                reflection=[[0.75, 0.95], [0.4, 0.8]][i // 2 % 2],
            )
        )
    return out


@family(40)
def clean3d_takes(n):
    """The arrays and rooms of `clean3d`, with the source at four places."""
    return [dict(table, takes=4) for table in clean3d(n)]


@family(16)
def fault3d(n):
    """Faults in space."""
    out = []
    F = [
        ["polarity", 0],
        ["known_error", 0.05],
        ["sound_speed", 0.03],
        ["gain", 1.0],
        ["channel_swap", 0],
        ["dead", 1.0],
        ["known_swap", 0],
        ["known_error", 0.01],
    ]
    for i in range(n):
        out.append(
            dict(
                seed=512000 + i,
                dimension=3,
                room="box",
                geometry=["ball", "shell", "cube"][i % 3],
                count=48,
                size=0.8,
                modes=60,
                highest=400.0,
                snr=40.0,
                noise=["reported", "unknown"][i % 2],
                known=5,
                fault=F[i % 8],
            )
        )
    return out


@family(6)
def line3d(n):
    """Arrays along a line in space."""
    return [
        dict(
            seed=513000 + i,
            dimension=3,
            room="box",
            geometry="line3",
            count=32,
            size=1.0,
            modes=45,
            highest=400.0,
            snr=[60.0, 40.0][i % 2],
            noise="reported",
            known=5,
            known_mode=["all", "none"][i % 2],
        )
        for i in range(n)
    ]


@family(24)
def blindcircle(n):
    """Blind arrays on a circle, for which the claimed sigma is too small."""
    out = []
    for i in range(n):
        r = np.random.default_rng([900, 20, i])
        out.append(
            dict(
                seed=520000 + i,
                geometry="circle",
                count=int(r.choice([16, 24, 32, 48, 60])),
                size=float(r.choice([0.6, 0.8, 1.2, 1.6, 2.0])),
                modes=int(r.choice([30, 45, 60])),
                highest=float(r.choice([250, 400])),
                snr=[20.0, 30.0, 40.0, 15.0][i % 4],
                noise=["reported", "unknown"][int(r.integers(2))],
                known=0 if i % 2 else 4,
                known_mode="none",
                decay=3.0,
            )
        )
    return out


@family(16)
def knownnear(n):
    """Known microphones that are neighbours: the rest is extrapolated, and the mirror image fits nearly as well."""
    out = []
    for i in range(n):
        r = np.random.default_rng([900, 21, i])
        out.append(
            dict(
                seed=521000 + i,
                geometry=["disc", "grid", "spiral", "clusters"][i % 4],
                count=int(r.choice([20, 30, 45])),
                size=float(r.choice([0.6, 1.2, 1.8])),
                modes=int(r.choice([20, 35, 50])),
                highest=300.0,
                snr=[40.0, 30.0, 20.0][i % 3],
                noise=["reported", "unknown"][int(r.integers(2))],
                known=int(r.choice([3, 4])),
                neighbours=True,
                decay=3.0,
            )
        )
    return out


@family(12)
def knownline3(n):
    """Arrays as in `knownnear`, with three known microphones far apart."""
    return [dict(s, known=3, neighbours=False, seed=522000 + i) for i, s in enumerate(knownnear(n))]


@family(24)
def ball3d_more(n):
    """24 to 40 microphones in wide arrays in space, some known, 45 to 60 frequencies: whether sigma is right."""
    out = []
    for i in range(n):
        r = np.random.default_rng([900, 23, i])
        out.append(
            dict(
                seed=523000 + i,
                dimension=3,
                room="box",
                geometry=["ball", "cube", "sphere", "slab"][i % 4],
                count=int(r.choice([24, 32, 40])),
                size=float(r.choice([0.5, 0.7, 0.9])),
                modes=int(r.choice([45, 60])),
                highest=450.0,
                snr=[40.0, 30.0, 20.0][i % 3],
                noise=["reported", "unknown"][int(r.integers(2))],
                known=int(r.integers(4, 8)),
                known_mode=["all", "all", "none"][int(r.integers(3))],
                frequencies="grid",
                reflection=[[0.75, 0.95], [0.5, 0.8]][i // 2 % 2],
                order=6,
            )
        )
    return out


@family(16)
def gainest(n):
    """Gain mismatch with estimated noise: whether the verdict detects it."""
    out = []
    for i in range(n):
        r = np.random.default_rng([900, 24, i])
        s = _base(i, r, 524000)
        s["noise"] = "unknown"
        s["snr"] = [40.0, 30.0, 25.0, 20.0][i % 4]
        s["fault"] = ["gain", [0.25, 0.5, 1.0][i % 3]]
        s["known_mode"] = ["all", "none"][i // 2 % 2]
        out.append(s)
    return out


@family(16)
def oneaway(n):
    """One bad channel in a sparse array: a delay of 0.2 to 1 ms, inverted polarity, or a gain of 6 dB."""
    out = []
    for i in range(n):
        r = np.random.default_rng([900, 25, i])
        s = _base(i, r, 525000)
        s["count"] = [16, 20, 24, 28][i % 4]
        s["size"] = [1.2, 0.8][i // 4 % 2]
        s["geometry"] = ["disc", "spiral", "circle"][i % 3]
        s["modes"] = 30
        s["fault"] = [["delay", 2e-4], ["delay", 1e-3], ["gain_one", 6.0], ["delay", 5e-4], ["polarity", 0]][i % 5]
        out.append(s)
    return out


def _of_scenarios(scenarios: list[Scenario], seed: int) -> list[dict]:
    """Return cases, each of which is a draw of a scenario of a study."""
    return [
        dict(
            seed=seed + i,
            dimension=len(one.room),
            scenario=one,
            count=one.microphones,
            snr=one.snr_db,
            known=one.known,
            takes=one.takes,
        )
        for i, one in enumerate(scenarios)
    ]


def _living_rooms(n: int, counts: list[int], seed: int) -> list[dict]:
    """Living rooms of the study, drawn separately for each case, with one of `counts` microphones and 25 to 40 dB."""
    base, out = calibration_study().scenario("living room, ball 32"), []
    for i in range(n):
        r = np.random.default_rng([900, 26, seed, i])
        count = int(r.choice(counts))
        radius = float(np.round(r.uniform(0.3, 0.45) * (count / 32) ** (1 / 6), 2))
        array = ["ball", "ball", "sphere"][int(r.integers(3))]
        snr = float(np.round(r.uniform(25, 40)))
        out.append(
            replace(base, name=f"{array} {count}, {i}", array=array, microphones=count, radius=radius, snr_db=snr)
        )
    return _of_scenarios(out, seed)


@family(30)
def livingroom(n):
    """The study's scenarios: 16 and 32 microphones, absorption by frequency, a cardioid, gain errors, four given."""
    scenarios = [one for one in calibration_study().scenarios if one.name.startswith("living room")]
    return _of_scenarios([scenarios[i % len(scenarios)] for i in range(n)], 526000)


@family(60)
def livingroom_few(n):
    """16 to 32 microphones in space in such rooms, at 25 to 40 dB."""
    return _living_rooms(n, [16, 20, 24, 28, 32], 527000)


@family(60)
def livingroom_many(n):
    """48 and 64 microphones in space in such rooms."""
    return _living_rooms(n, [48, 64], 528000)


@family(60)
def temperature(n):
    """The air is 2 to 6 K warmer or colder than stated."""
    base, out = calibration_study().scenario("disc 24, 1 % in c"), []
    for i in range(n):
        r = np.random.default_rng([900, 29, i])
        kelvin = float(r.uniform(2, 6) * r.choice([-1, 1]))
        known, snr = int(r.integers(3, 7)), [60.0, 40.0, 30.0][int(r.integers(3))]
        error = float(np.round(-kelvin / (2 * 293), 5))  # c rises by half of a relative change of temperature
        out.append(replace(base, name=f"{kelvin:+.2f} K, {i}", sound_speed_error=error, known=known, snr_db=snr))
    return _of_scenarios(out, 529000)


@family(60)
def sphere_room(n):
    """Arrays on the surface of a sphere in a room."""
    base, out = calibration_study().scenario("sphere 32, 40 dB"), []
    for i in range(n):
        r = np.random.default_rng([900, 30, i])
        count, radius = int(r.choice([24, 32, 48])), float(np.round(r.uniform(0.25, 0.5), 2))
        snr = [40.0, 30.0][int(r.integers(2))]
        out.append(replace(base, name=f"sphere {count}, {i}", microphones=count, radius=radius, snr_db=snr))
    return _of_scenarios(out, 530000)
