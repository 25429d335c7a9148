"""Commands for files of other programs: `import`, `export`, `correct` and `doctor`."""

import typing
from dataclasses import fields, replace

import click

from ..model.validation import InputError
from ..recordings.import_options import ImportOptions
from .options import OPTIONS, files_options, force_option, output_option, output_path, progress_bar
from .parameter_types import Number, RecordingKind


def _import_options(command):
    """Add an option for each field of `ImportOptions` that has a help text."""
    types = typing.get_type_hints(ImportOptions)
    for field in reversed([field for field in fields(ImportOptions) if "help" in field.metadata]):
        choices = field.metadata["choices"]
        allowed = types[field.name], *typing.get_args(types[field.name])
        kind = int if int in allowed else Number() if float in allowed else str
        command = click.option(
            f"--{field.name.replace('_', '-')}",
            type=RecordingKind(choices) if field.name == "kind" else click.Choice(choices) if choices else kind,
            default=str(field.default) if choices and field.default is not None else field.default,
            show_default=field.default is not None,
            metavar=field.metadata["metavar"],
            help=field.metadata["help"],
        )(command)
    return command


@click.command("import")
@click.argument("sources", nargs=-1, required=True, metavar="INPUT...")
@output_option("FILE.npz")
@files_options
@_import_options
@force_option
def import_(sources, output, files, number, dimension, array_dimension, force, **options):
    """Turn recordings or impulse responses into a measurement.

    INPUT is a WAV or FLAC file, a SOFA file, a folder of them or of MeshRIR, an HDF5 file of Acoular, or an .npz file;
    or, with --array, the .mat file of a measured room: an impulse response with directions of arrival.

    Several files are takes, of the same channels with the source at other places; files of one channel each are the
    channels of one take.
    """
    path = output_path(output, ".npz", force, *sources, options["reference"])
    from ..model.measurement_file import save_measurement
    from ..model.storage import write_atomically
    from ..recordings.importer import import_recording, import_summary

    asked = ImportOptions(source=number, files=files or "auto", dimension=int(dimension), **options)
    asked = replace(asked, array_dimension=int(array_dimension) if array_dimension else None)
    measurement, report = import_recording(sources, asked)
    write_atomically(path, lambda file: save_measurement(measurement, file), force)
    print(import_summary(measurement, report, OPTIONS))
    print(path)


@click.command()
@click.argument("result", metavar="RESULT.json")
@output_option("FILE.csv|json|xml|sofa|npy")
@click.option(
    "--frame", type=click.Choice(["known", "minimal", "axes"]), help="Coordinate axes.  [default: known, else axes]"
)
@click.option("--original", metavar="FILE.sofa", help="Write the positions into a copy of this file.")
@click.option(
    "--table",
    type=click.Choice(["positions", "gains"]),
    default="positions",
    show_default=True,
    help="gains: a .csv table of gain, phase, noise and fault of every channel, of solver robust, or Acoular's .xml of"
    " factors.",
)
@force_option
def export(result, output, frame, original, table, force):
    """Write positions or gains of a result for other programs.

    The suffix of the file selects the format.
    """
    from ..assessment.result_file import load_result
    from ..recordings import formats
    from ..recordings.export import export_gains, export_positions

    if table == "gains":
        for key, value in (("frame", frame), ("original", original)):
            if value is not None:
                raise InputError("--table gains writes no positions", f"leave out <{key}>", key=key, value=value)
        path = output_path(output, (".csv", ".xml"), force, result)
        calibration = load_result(result)
        export_gains(calibration, path, force)
        print(f"{path}: gains of {len(calibration.names)} channels")
        return
    path = output_path(output, formats.suffixes("write"), force, result, original)
    if original is not None and path.suffix.lower() != ".sofa":
        remedy = f"leave it out for {path.suffix}"
        raise InputError(f"--original {original} is for -o FILE.sofa", remedy, key="original", value=original)
    placed = export_positions(load_result(result), path, frame, original, force)
    print(f"{path}: {len(placed.names)} microphones, frame: {placed.frame}")


@click.command()
@click.argument("recording", metavar="RECORDING")
@click.argument("result", metavar="RESULT.json")
@output_option("FILE.wav")
@force_option
def correct(recording, result, output, force):
    """Take the differences of the channels out of a recording.

    Gains, phases, polarity, delays and the order of the channels are corrected as RESULT found them with solver robust;
    the file has 32-bit floats.
    """
    from ..assessment.result_file import load_result
    from ..recordings import formats
    from ..recordings.export import SUFFIXES, correction_of, correction_summary, write_corrected

    path = output_path(output, SUFFIXES, force, recording, result)
    recorded = formats.read(recording)
    correction = correction_of(load_result(result), recorded)
    write_corrected(path, recorded, correction, force)
    print(correction_summary(correction, recorded.names))
    print(path)


@click.command()
@click.argument("sources", nargs=-1, required=True, metavar="FILE...")
@click.option("--positions", metavar="FILE.xml|csv", help="List to compare with: Acoular's XML, or name,x,y[,z].")
@files_options
@click.option("--kind", type=RecordingKind(("auto", "impulse", "stationary")), help="As of `fdcal import`.")
@click.option("--temperature", type=Number(), metavar="C", help="Of the air, degrees Celsius; of recordings.")
@output_option("FILE.html", required=False)
@force_option
def doctor(sources, positions, files, split, number, kind, temperature, output, force):
    """Tell whether a recording, or a published data set, is what it says.

    FILE is what `fdcal calibrate` takes. Each finding is one line: channels that are silent, clipped, copies or
    different; responses that wrap round; clocks that differ; whether there is one sound field, and a measured one;
    whether the list fits. -o writes them with a picture each.

    The exit code is 5 if the list does not fit, else 4 if anything else is at fault.
    """
    path = output_path(output, ".html", force, *sources, positions) if output else None
    from ..session.doctor import examine
    from ..session.sources import is_recording

    given = {"files": files, "split": split, "source": number, "kind": kind, "temperature": temperature}
    given = {key: value for key, value in given.items() if value is not None}
    other = next((one for one in sources if not is_recording(one)), None)
    if given and other is not None:
        key = next(iter(given))
        raise InputError(f"{other} holds no recordings", f"leave out <{key}>", key=key, value=given[key])
    with progress_bar("examining") as progress:
        findings = list(examine(sources, positions, ImportOptions(**given), progress))
    if path is not None:
        from ..graphics.doctor_page import doctor_page
        from ..model.storage import write_atomically

        page = doctor_page(f"{sources[0]}{f' and {len(sources) - 1} more' if len(sources) > 1 else ''}", findings)
        write_atomically(path, lambda file: file.write_text(page, encoding="utf-8"), force)
    print("\n".join(one.line for one in findings))
    at_fault = {one.question for one in findings if one.state == "fault"}
    return 5 if "list" in at_fault else 4 if at_fault else 0


COMMANDS = (import_, export, correct, doctor)
