"""Hostile paths, streams and requests: counts of those that the command line or the page handles wrongly.

Files with broken bytes and hostile messages are in `fuzz`. Here are paths that are not files (pipes, devices, loops of
links), files that change or end while they are read, a full disk, arrays beyond any bound, and requests of clients that
are not the page. A command has to end in SECONDS, with one line on standard error and a documented exit code, and must
leave nothing behind.
"""

import os
import resource
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import soundfile

from fdcal.model.measurement import Measurement, save_measurement

from .report import Figure

ALONE = True
SECONDS = 120.0
RATE, COUNT = 4000, 8
READERS = {  # arguments of a command that reads `{}`, by the suffix of that file
    "import": ((".wav", ".flac", ".h5", ".sofa", ".npz", ".npy", ".mat", ".csv"), "import {} -o o.npz"),
    "calibrate": ((".npz", ".toml", ".wav"), "calibrate {}"),
    "--positions": ((".csv", ".xml", ".json", ".npy", ".sofa"), "calibrate good.npz --check --positions {}"),
    "--known": ((".csv",), "import good.wav -o o.npz --known {}"),
    "--reference": ((".wav",), "import good.wav -o o.npz --reference {}"),
    "export": ((".json",), "export {} -o o.csv"),
    "plan": ((".csv", ".npy"), "plan {} --room 6x5x2.7"),
    "view": ((".zip", ".npz", ".toml"), "view {} --port 0 --no-browser"),
    "doctor": ((".wav", ".npz"), "doctor {}"),
}


def fault_of(arguments: str, folder: Path, limit: Callable[[], object] | None = None, codes=(2, 3)) -> str:
    """Return what is wrong with how a command ends; "" where it refuses its input in one line and leaves nothing."""
    before = sorted(folder.iterdir())
    command = [sys.executable, "-m", "fdcal", *arguments.split()]
    try:
        run = subprocess.run(
            command,
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=SECONDS,
            preexec_fn=limit,
            stdin=subprocess.DEVNULL,
        )
    except subprocess.TimeoutExpired:
        return f"{arguments}: more than {SECONDS:g} s"
    lines = [line for line in run.stderr.splitlines() if line.startswith("error: ")]
    if run.returncode not in codes or len(lines) != (run.returncode in (1, 2, 3)) or "Traceback" in run.stderr:
        return f"{arguments}: code {run.returncode}, {run.stderr[-300:]!r}"
    if any(not x.isprintable() and x not in "\n\r\t" for x in run.stdout):
        return f"{arguments}: control characters"
    if run.returncode in (2, 3) and sorted(folder.iterdir()) != before:
        return f"{arguments}: files are left behind"
    return ""


def make_good(folder: Path) -> None:
    """Write a recording and a measurement without faults."""
    rng = np.random.default_rng(0)
    soundfile.write(folder / "good.wav", 0.1 * rng.standard_normal((4 * RATE, COUNT)), RATE)
    save_measurement(measurement(COUNT, 12), folder / "good.npz")


def measurement(count: int, rows: int) -> Measurement:
    """Return the pressures of plane waves at an array in the plane."""
    rng = np.random.default_rng(1)
    f, x = np.linspace(100, 300, rows), rng.uniform(-0.4, 0.4, (count, 2))
    waves = rng.standard_normal((30, 2)) @ np.diag([1, 1j]) @ np.ones((2, 1))
    angle = rng.uniform(0, 2 * np.pi, 30)
    phase = np.stack([np.cos(angle), np.sin(angle)]) * (2 * np.pi * f[:, None, None] / 343)
    p = np.exp(1j * np.einsum("nd,mdw->mnw", x, phase)) @ waves[:, 0]
    return Measurement(frequencies=f, pressures=p, sound_speed=343.0, dimension=2, positions=x, known=(0, 1, 2))


def no_files(folder: Path) -> Iterator[str]:
    """Yield the faults of readers of pipes, devices, loops of links, and very long names."""
    kinds: dict[str, Callable[[Path], object]] = {
        "pipe": os.mkfifo,
        "device": lambda path: path.symlink_to("/dev/zero"),
        "loop": lambda path: path.symlink_to(path),
        "folder": Path.mkdir,
    }
    for suffixes, arguments in READERS.values():
        for suffix in suffixes:
            for make in kinds.values():
                path = folder / f"odd{suffix}"
                make(path)
                yield fault_of(arguments.format(path.name), folder)
                path.rmdir() if path.is_dir() and not path.is_symlink() else path.unlink()
            yield fault_of(arguments.format("x" * 5000 + suffix), folder)


def full_disk(folder: Path) -> Iterator[str]:
    """Yield the faults of writers where no byte can be written."""

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))

    fault = fault_of("calibrate good.npz -o r.json --time-limit 5", folder, codes=(0, 4))
    yield fault
    for suffix in ("csv", "json", "xml", "sofa", "npy"):
        if not fault:
            yield fault_of(f"export r.json -o o.{suffix}", folder, limit, codes=(0, 3))
            (folder / f"o.{suffix}").unlink(missing_ok=True)
    yield fault_of("simulate tiny -o o.npz", folder, limit, codes=(3,))
    yield fault_of("import good.wav -o o.npz", folder, limit, codes=(2, 3))


def beyond_bounds(folder: Path) -> Iterator[str]:
    """Yield the faults of arrays that are too large, of takes that do not fit, and of a file that changes meanwhile."""
    save_measurement(measurement(1000, 20), folder / "many.npz")
    yield fault_of("calibrate many.npz --time-limit 5", folder, codes=(0, 2, 4))
    wide = measurement(COUNT, 12)
    save_measurement(
        replace(wide, positions=1000 * np.asarray(wide.positions), known=(), known_positions=None), folder / "mm.npz"
    )
    yield fault_of("landscape mm.npz --microphone 3 -o o.svg", folder, codes=(2,))
    np.savez(
        folder / "flat.npz",
        frequencies=[100.0, 200.0],
        pressures=np.ones((2, 9), complex),
        sound_speed=343.0,
        dimension=4,
    )
    yield fault_of("calibrate flat.npz", folder)
    samples = np.random.default_rng(2).standard_normal((2 * RATE, COUNT)) / 9
    soundfile.write(folder / "rate.wav", samples, 2 * RATE)
    soundfile.write(folder / "count.wav", samples[:, 1:], RATE)
    for other in ("rate.wav", "count.wav"):
        yield fault_of(f"import good.wav {other} -o o.npz", folder)
    path = folder / "growing.wav"
    shutil.copy(folder / "good.wav", path)
    command = [sys.executable, "-m", "fdcal", "import", path.name, "-o", "o.npz", "--force"]
    for delay in (0.5, 1.0, 1.5, 2.0, 3.0):
        run = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        time.sleep(delay)
        os.truncate(path, 50_000)
        errors = run.communicate(timeout=SECONDS)[1]
        shutil.copy(folder / "good.wav", path)
        yield f"a file that shrinks after {delay:g} s: {errors[-300:]!r}" if run.returncode not in (0, 2, 3) else ""


def damaged_study(folder: Path) -> Iterator[str]:
    """Yield the faults of a study with 200 damaged files of rows: of its report, and of --resume."""
    (folder / "study.toml").write_text('title = "two"\nscene = "tiny"\ndraws = 2\n[axes]\nsnr_db = [30]\n')
    yield fault_of("study study.toml -o results", folder, codes=(0, 4))
    rng = np.random.default_rng(3)
    for number in range(200):
        (folder / f"results/rows/part-{number:09d}-{number:06x}.parquet").write_bytes(b"PAR1" + rng.bytes(number))
    yield fault_of("study --report results", folder)
    yield fault_of("study study.toml -o results --resume", folder, codes=(0, 4))
    yield fault_of("study --report results", folder, codes=(0,))


def strangers(folder: Path) -> Iterator[str]:
    """Yield the faults of a page that gets requests of other clients, and ends while some are half connected."""
    command = [sys.executable, "-m", "fdcal", "view", "tiny", "--port", "0", "--no-browser"]
    served = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert served.stdout is not None
    port = int(served.stdout.readline().rpartition(":")[2])
    own = f"127.0.0.1:{port}"
    for path, host, expected in (
        ("/", own, 200), ("/", "evil.example", 403), ("/", f"evil.example:{port}", 403), ("/" + "a" * 5000, own, 404),
        ("/" + "a" * 300, own, 404), ("/../../etc/passwd", own, 404), ("/%2e%2e/%2e%2e/etc/passwd", own, 404),
    ):  # fmt: skip
        with socket.create_connection(("127.0.0.1", port), SECONDS) as client:
            client.sendall(f"GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
            status = client.recv(200).split(b" ")[1:2]
        yield "" if status == [str(expected).encode()] else f"GET {path[:40]} of {host}: {status}, not {expected}"
    half = [socket.create_connection(("127.0.0.1", port), SECONDS) for _ in range(20)]
    for client in half[:10]:
        client.sendall(b"GET / HTTP/1.1\r\n")
    start = time.perf_counter()
    served.send_signal(signal.SIGINT)
    errors = served.communicate(timeout=60)[1]
    spent = time.perf_counter() - start
    yield f"ended after {spent:.1f} s" if spent > 5 else ""
    yield f"said at the end: {errors[-300:]!r}" if "Traceback" in errors or "warning" in errors.lower() else ""


def run() -> Iterator[Figure]:
    for attack in (no_files, full_disk, beyond_bounds, damaged_study, strangers):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            make_good(folder)
            start, found = time.perf_counter(), list(attack(folder))
        faults = [fault for fault in found if fault]
        for fault in faults:
            print(fault, flush=True)
        spent = time.perf_counter() - start
        yield Figure(f"{attack.__name__}: faults in {len(found)} cases", len(faults), f"{spent:.0f} s", "0", not faults)
