"""One case through the command line, compared with the truth."""

import json
import re
import resource
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from .bound import bound
from .cases import Case

CONFIDENT_SIGMAS, CONFIDENT_ERROR = 5.0, 0.01  # sigmas, metres; an error of a microphone above both makes "good" wrong
RMS_SIGMAS, RIGHT_ERROR = 3.0, 0.005  # the same for the RMS error of all; one below RIGHT_ERROR is always right
FAULTY = ("polarity", "dead", "gain_one", "delay")  # faults whose channel need not be placed


@dataclass(frozen=True)
class Score:
    """The result of a case, compared with the truth.

    outcome : "ran", "hang", "refused" or "crash"; seconds : of processor; verdict : its code; error, claim, limit :
    RMS error, claimed RMS error and Cramer-Rao bound of the healthy microphones, metres; right : the error is below
    5 mm or three times the bound; placeable : the bound is below a tenth of the array's root mean square radius, beyond
    which no verdict is good; confidently_wrong : the verdict is good and should not be; named : every channel or
    position at fault is named; judged, covered : number of microphones that are sought and trusted, and of those inside
    their ellipse of 95 %
    """

    outcome: str
    seconds: float
    verdict: str = ""
    error: float = np.nan
    claim: float = np.nan
    limit: float = np.nan
    right: bool = False
    placeable: bool = False
    confidently_wrong: bool = False
    named: bool = False
    judged: int = 0
    covered: int = 0


def run_case(case: Case, limit_s: float = 60.0, arguments: tuple[str, ...] = ()) -> Score:
    """Calibrate `case` by the command line in at most `limit_s` seconds of processor time, and score it."""
    with tempfile.TemporaryDirectory() as folder:
        source, output = Path(folder) / "case.npz", Path(folder) / "result.json"
        np.savez_compressed(source, **case.table)
        command = [sys.executable, "-m", "fdcal", "calibrate", str(source), "--known", _known_option(case)]
        command += ["--modes", str(len(case.table["frequencies"])), "-o", str(output), *arguments]
        outcome, seconds = _run(command, limit_s, output)
        if outcome != "ran":
            return Score(outcome, seconds)
        return _scored(case, json.loads(output.read_text()), seconds)


def _known_option(case: Case) -> str:
    return case.spec.known_mode if case.spec.known else "all"


def _run(command, limit_s: float, output: Path) -> tuple[str, float]:
    """Outcome and processor time of a child process."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    try:
        child = subprocess.run(
            command,
            capture_output=True,
            timeout=4 * limit_s,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (int(limit_s), int(limit_s) + 5)),
        )
    except subprocess.TimeoutExpired:
        return "hang", 4 * limit_s
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    if child.returncode in (0, 4) and output.exists():
        return "ran", seconds
    if child.returncode in (-24, -9, 137, 152):
        return "hang", seconds
    return "refused" if child.returncode == 2 else "crash", seconds


def _scored(case: Case, result: dict, seconds: float) -> Score:
    x, claimed = np.array(result["positions"], float), np.array(result["uncertainty_m"], float)
    found = x
    names, faulty = [str(name) for name in result["names"]], _faulty(result)
    fault = "" if case.spec.fault is None else case.spec.fault[0]
    sick = set(map(str, case.named)) if fault in FAULTY else set()
    healthy = np.array([name not in sick for name in names])
    trusted = np.array([name not in faulty for name in names])
    if case.spec.blind:
        x = _aligned(x, case.positions, healthy)
    free = np.ones(len(x), bool)
    if not case.spec.blind and case.spec.known_mode == "all" and not fault.startswith(("known", "channel")):
        free[case.known] = False
    errors = np.linalg.norm(x - case.positions, axis=1)
    error, claim = _rms(errors[free & healthy]), _rms(claimed[free & healthy])
    judged = free & trusted
    far = (errors[judged] > CONFIDENT_SIGMAS * np.maximum(claimed[judged], 1e-9)) & (errors[judged] > CONFIDENT_ERROR)
    wrong = far.any() or (error > RMS_SIGMAS * claim and error > RIGHT_ERROR)
    limit = bound(case)
    return Score(
        "ran",
        seconds,
        result["verdict"],
        error,
        claim,
        limit,
        right=error < max(RIGHT_ERROR, 3 * limit),
        placeable=limit < 0.1 * _rms(np.linalg.norm(case.positions - case.positions.mean(axis=0), axis=1)[healthy]),
        confidently_wrong=bool(result["verdict"] == "good" and wrong),
        named=bool(case.named) and set(map(str, case.named)) <= faulty,
        judged=int(np.sum(judged & healthy)),
        covered=_covered(found, result.get("covariance_m2"), case, healthy, judged & healthy),
    )


def _covered(found, covariance, case: Case, healthy, judged) -> int:
    """Return how many of the microphones `judged` (N,) bool are inside their ellipse of 95 %."""
    if covariance is None:
        return 0
    truth = _aligned(case.positions, found, healthy) if case.spec.blind else case.positions
    shares = np.array(covariance, float)[judged]
    usable = np.isfinite(shares).all(axis=(1, 2)) & (np.linalg.det(shares) > 0)
    away = (found - truth)[judged][usable]
    distance = np.einsum("na,nab,nb->n", away, np.linalg.inv(shares[usable]), away)
    return int(np.sum(distance <= chi2.ppf(0.95, found.shape[1])))


def _faulty(result: dict) -> set[str]:
    """Names of the channels that the result calls faulty."""
    named = {entry["name"] if isinstance(entry, dict) else str(entry) for entry in result.get("odd_channels", ())}
    if named or result["verdict"] != "known_position":
        return named
    return set(re.findall(r"\b\d+\b", result["verdict_text"])) & {str(name) for name in result["names"]}


def _aligned(x, truth, chosen) -> np.ndarray:
    """`x` (N, D) after the best rigid motion of the microphones `chosen` (N,) bool onto `truth` (N, D), metres."""
    middle, goal = x[chosen].mean(axis=0), truth[chosen].mean(axis=0)
    u, _, vt = np.linalg.svd((x[chosen] - middle).T @ (truth[chosen] - goal))
    return (x - middle) @ (u @ vt) + goal


def _rms(errors) -> float:
    return float(np.sqrt(np.mean(errors**2))) if len(errors) else np.nan
