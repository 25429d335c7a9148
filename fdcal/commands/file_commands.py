"""Commands for recordings and files of other programs: `import`, `export`, `doctor` and `record`."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import click

from ..assessment.calibration import placed_in_frame
from ..assessment.result_file import load_result, save_result
from ..model.measurement import save_measurement
from ..model.storage import TEMPORARY, write_atomically
from ..model.validation import InputError, StorageError, convert, within
from ..recordings import export as exports
from ..recordings import formats
from ..recordings.formats.positions import read_positions
from ..recordings.recording import ImportOptions
from ..session.process import interrupts
from ..session.sources import compared_with_file, measurement_input
from . import options as opt
from . import report


@click.command("import")
@click.argument("sources", nargs=-1, required=True, metavar="INPUT...")
@opt.output_option("FILE.npz")
@opt.recording_options()
@opt.force_option
def import_(sources, output, force, **recorded):
    """Turn recordings or impulse responses into a measurement.

    INPUT is a sound file, a folder of sound files, a SOFA file, a folder of the MeshRIR data set, or a file with arrays
    of samples: .npz, .npy, .mat, .h5, .csv.

    Several files are several takes of the same channels, each with the source at another place. Files with one channel
    each are the channels of a single take.
    """
    path = opt.output_path(output, ".npz", force, *sources, recorded["reference"])
    from ..recordings.importer import import_recording, import_summary

    given = {key: value for key, value in recorded.items() if value is not None}
    with opt.progress_bar("importing") as progress:
        measurement, imported = import_recording(sources, ImportOptions(**given), progress)
    write_atomically(path, lambda file: save_measurement(measurement, file), force)
    print(import_summary(measurement, imported, opt.OPTIONS))
    print(path)


@click.command()
@click.argument("result", metavar="RESULT.json")
@opt.output_option("FILE.csv|json|xml|sofa|npy")
@opt.option("--frame", "Coordinate axes.  [default: those of the result]", type=["known", "minimal", "axes"])
@opt.option("--table", "gains: as .csv or as Acoular's .xml.", type=["positions", "gains"], default="positions")
@opt.force_option
def export(result, output, frame, table, force):
    """Write positions or gains of a result for other programs.

    The suffix of the file selects the format.
    """
    allowed = list(exports.GAIN_TEXTS) if table == "gains" else formats.suffixes("write")
    path, found = opt.output_path(output, allowed, force, result), load_result(result)
    exports.export(found, path, frame=frame, table=table, force=force)
    if table == "gains":
        print(f"{path}: gains of {len(found.names)} channels")
    else:
        print(f"{path}: {len(found.names)} microphones, frame: {placed_in_frame(found, frame).frame}")


@click.command()
@click.argument("sources", nargs=-1, required=True, metavar="FILE...")
@opt.option("--positions FILE", "Positions to compare with: a table name,x,y[,z], or a geometry file.")
@opt.recording_options(*opt.RECORDED)
def doctor(sources, positions, **recorded):
    """Check whether a recording, or a published data set, is what it claims to be.

    FILE is a recording, a measurement or a scene. Each finding is one line. The findings are about channels that are
    silent, clipped, copies of others or unlike the others; impulse responses that wrap round; clocks that differ;
    whether all channels recorded one sound field, and whether it was measured or simulated; and whether the list of
    positions fits.

    The exit code is 5 if the list does not fit, otherwise 4 if there is any other fault or the list cannot be judged.
    """
    from ..session.doctor import examine

    options = opt.import_options(sources, recorded)
    with opt.progress_bar("examining") as progress:
        findings = list(examine(sources, positions, options, progress, opt.OPTIONS))
    print("\n".join(one.line for one in findings))
    at_fault = {one.question for one in findings if one.state == "fault"}
    unjudged = positions is not None and any((one.question, one.state) == ("list", "unknown") for one in findings)
    return 5 if "list" in at_fault else 4 if at_fault or unjudged else 0


@click.command()
@click.argument("earlier", nargs=-1, metavar="[EARLIER...]")
@opt.output_option("TAKE.wav|w64")
@opt.option("--channels N", "inputs", "Record only the first N inputs.  [default: all]", type=click.IntRange(1))
@opt.option("--seconds", "Length of each take.", type=float, default=30.0)
@opt.option("--rate HZ", "Sampling rate.  [default: the card's]", type=float)
@opt.option("--device NAME|NUMBER", "Sound card: python -m sounddevice lists them.")
@opt.option("--replay FILE", "Recording to use instead of a sound card; give one for each take.", multiple=True)
@opt.option("--positions FILE", "List of all positions, by which swapped channels are found.")
@opt.option("--known FILE", "Known microphones: a table name,x,y[,z].")
@opt.declared_options(ImportOptions, ("temperature", "array_dimension"))
@opt.option("--result RESULT.json", "File to which the result is written after each take.")
@opt.force_option
def record(earlier, output, inputs, seconds, rate, device, replay, positions, known, temperature, array_dimension,
           result, force: bool):  # fmt: skip
    """Record takes, and print after each take where the microphones are.

    EARLIER are files of takes of the same array that were recorded before. The first take is written to TAKE, and each
    further one to the file with the next free number: take2.wav, take3.wav. While a take is recorded, the command names
    silent, clipped and duplicated channels. After the take it names inverted and dead channels and, with --positions,
    swapped ones. Ctrl-C ends the take and the command, and keeps what was recorded.

    The exit code is that of `fdcal calibrate --check` for all takes together, 4 if they give no result, and 130 after
    Ctrl-C.
    """
    from tqdm import tqdm

    from ..recordings.take import SUFFIXES, check_take, next_take, record_take, replayed, sound_card

    seconds = convert(seconds, Annotated[float, within(1, 86400, "s")], "seconds")
    rate = None if rate is None else convert(rate, Annotated[float, within(1000, 1e7, "Hz")], "rate")
    if replay and (device is not None or rate is not None):
        key = "rate" if device is None else "device"
        raise InputError("the takes are read from files, not from a sound card", f"leave out <{key}>", key=key)
    options = ImportOptions(
        leave_out="bad", files="takes", known=known, temperature=temperature, array_dimension=array_dimension
    )
    # Files are checked before anything is recorded.
    for file in filter(None, (positions, known)):
        read_positions(file)
    path = opt.output_path(output, SUFFIXES, force, *earlier, *replay)
    found_path = opt.output_path(result, ".json", force, *earlier, *replay, flag="--result") if result else None
    for file in earlier:
        formats.read(file)
    for file in replay:
        check_take(replayed(file, inputs), path, seconds)
    for left in sorted(path.parent.glob(f"{TEMPORARY}*{path.suffix}")):
        print(f"an unfinished take exists: mv {left} NAME{path.suffix} keeps it, rm {left} deletes it")
    paths, written = list(earlier), 0
    while True:
        stream = replayed(replay[written], inputs) if replay else sound_card(inputs, rate, device)
        with interrupts(urgent=False) as interrupt, opt.progress_bar("recording") as progress:
            known_faults = dict[int, str]()

            def watch(done, health, names=stream.names, interrupt=interrupt, progress=progress, known=known_faults):
                progress(min(done / seconds, 1.0))
                for n in map(int, health.bad) if done >= 1 else ():
                    if known.get(n) != (fault := health.fault(n, names)):
                        known[n] = fault
                        tqdm.write(f"after {done:.1f} s: channel {names[n]} is {fault}")  # above the bar
                        print(end="", flush=True)
                return not interrupt.is_set()

            take = record_take(stream, path, seconds, watch, force)
        print(f"take {len(paths) + 1}  {take.text}", flush=True)
        if take.stopped:
            return 130  # interrupted
        paths, written = [*paths, str(path)], written + 1
        code, following = _result(paths, positions, options, found_path), next_take(path)
        answer = "" if replay else _answer(path.name, following.name)
        if answer == "q" or (replay and written == len(replay)):
            return code
        if answer == "r":
            force, paths = True, paths[:-1]
        else:
            path, force = following, False


def _result(paths: list[str], positions: str | None, options: ImportOptions, path: Path | None) -> int:
    """Calibrate all takes together, print the result and write it to a file; return the exit code of `calibrate`."""
    from ..recordings.importer import measurement_of_takes, read_takes
    from ..session.calibration_run import solve

    try:
        measurement, imported = measurement_of_takes(read_takes(paths, options), options)
        inputs = measurement_input(measurement, "takes" if len(paths) > 1 else "take")
        if positions is not None:
            inputs = compared_with_file(replace(inputs, excluded=tuple(imported.left_out)), positions)
        result = solve(inputs, wording=opt.OPTIONS)
        check = None if inputs.measurement.positions is None else report.comparison(inputs, result)
    except (InputError, StorageError) as error:
        print(f"result  none: {error.worded(opt.OPTIONS) if isinstance(error, InputError) else error}", flush=True)
        return 4
    lines, wrong = report.takes_report(len(paths), inputs, result, check)
    print("\n".join(lines), flush=True)
    if path is not None:
        save_result(result, path, force=True, check=check)
    return 5 if wrong else 0 if result.verdict == "good" else 4


def _answer(this: str, following: str) -> str:
    """Ask what to do next; return "" for another take, "r" for this take again, "q" to end or if nobody can answer."""
    question = f"Move the loudspeaker. Press Enter to record {following}, r to record {this} again, q to end: "
    try:
        while (answer := input(question).strip().lower()) not in ("", "r", "q"):
            pass
        return answer
    except EOFError:
        print()
        return "q"


COMMANDS = (import_, export, doctor, record)
