"""ninedtact hardware: files to make the parts, bill of materials, checks, comparison of designs, and how to build the
sensor."""

import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from ninedtact.cli.result_and_interrupt import print_result
from ninedtact.cli.shared_options import ClusterOption, JsonOption, WorkersOption
from ninedtact.required_libraries import require_libraries
from ninedtact_hardware.design import DesignVariant
from ninedtact_hardware.design_sweep import USUAL_SWEEP, DesignSweep

if TYPE_CHECKING:
    from ninedtact_hardware.bill_of_materials import BillItem
    from ninedtact_hardware.buildable_design import BuildableDesign
    from ninedtact_hardware.design import HardwareDesign
    from ninedtact_hardware.design_comparison import ExploredDesign


@dataclass(frozen=True)
class DesignOptions:
    """The design that a hardware command works on."""

    design: Path | None = None
    """Design file (TOML) with what differs from the published sensor. Tables such as [hardware.shell] change its parts."""
    variant: DesignVariant = "default"
    """default: with the improvements that docs/hardware.md lists. original: with the original's dimensions."""

    def read_hardware(self) -> "HardwareDesign":
        """Return the hardware design; raises `FileFormatError`, `DesignImpossible`."""
        from ninedtact_hardware.design_file import read_hardware_design

        return read_hardware_design(self.design, self.variant)

    def build_sensor(self) -> "BuildableDesign":
        """Return the design with its solids; raises `DesignNotBuildable`, `MissingLibraryError`."""
        design = self.read_hardware()
        _require_build123d()
        from ninedtact_hardware.buildable_design import BuildableDesign

        return BuildableDesign(design)


def _require_build123d() -> None:
    require_libraries("hardware", "build123d")


@dataclass(frozen=True)
class BomCommand:
    """List the parts of one sensor, its adapter and cable, and the tools to make it, with estimated prices."""

    design_options: Annotated[DesignOptions, tyro.conf.arg(name="")] = DesignOptions()
    json: JsonOption = False

    def run(self) -> int:
        """Build the parts and print the bill of materials."""
        from ninedtact_hardware.bill_of_materials import bill_items_cost_usd, sensor_cost_usd

        items = self.design_options.build_sensor().bill
        table = {
            "items": [{**asdict(item), "usd": item.usd} for item in items],
            "sensor_usd_estimated": sensor_cost_usd(items),
            "sensor_in_use_usd_estimated": bill_items_cost_usd(items, "sensor", "connection"),
            "total_usd_estimated": bill_items_cost_usd(items),
        }
        return print_result(self.json, table, format_bill_of_materials(items))


def format_bill_of_materials(items: "list[BillItem]") -> Iterator[str]:
    """Yield the bill of materials as lines of text."""
    from ninedtact_hardware.bill_of_materials import BILL_SECTIONS, bill_items_cost_usd, sensor_cost_usd
    from ninedtact_hardware.published_specifications import PUBLISHED_9DTACT

    for kind, heading in BILL_SECTIONS.items():
        yield f"{heading}: {bill_items_cost_usd(items, kind):.2f} $"
        yield from (
            f"  {item.count} x {item.name:20}{item.usd:7.2f} $  {item.what}" for item in items if item.kind == kind
        )
    published = f"the paper says about {PUBLISHED_9DTACT.cost_usd:g} $"
    yield f"parts of one sensor: about {sensor_cost_usd(items):.2f} $ by estimated prices; {published}"
    connected, with_tools = bill_items_cost_usd(items, "sensor", "connection"), bill_items_cost_usd(items)
    yield f"with adapter and cable: {connected:.2f} $; with all tools: {with_tools:.2f} $"


@dataclass(frozen=True)
class CheckHardwareCommand:
    """Check whether a design can be built: rules, interference and clearances. Prints its specification beside the
    paper's Table I.

    Exits with 1 if a rule is broken, if two parts overlap, or if the LED board has to be redrawn.
    """

    design_options: Annotated[DesignOptions, tyro.conf.arg(name="")] = DesignOptions()
    json: JsonOption = False

    def run(self) -> int:
        """Check the rules; build and measure a design that keeps them."""
        from ninedtact_hardware.buildability import find_broken_rules

        design = self.design_options.read_hardware()
        if broken := find_broken_rules(design):
            return self._refuse([(each.rule, each.message) for each in broken])
        _require_build123d()
        from ninedtact.design import DesignImpossible
        from ninedtact_hardware.buildable_design import BuildableDesign

        try:
            sensor = BuildableDesign(design)
            table = {"broken": [], **sensor.to_json_dict()}
        except DesignImpossible as refused:
            return self._refuse([("part_not_modelled", str(refused))])
        print_result(self.json, table, sensor.check_report_lines())
        return 1 if table["interferences"] or table["led_board_differences"] else 0

    def _refuse(self, broken: list[tuple[str, str]]) -> int:
        table = {"broken": [{"rule": rule, "message": message} for rule, message in broken]}
        count = "1 rule" if len(broken) == 1 else f"{len(broken)} rules"
        lines = [f"{count} broken; nothing was built:", *(f"  {rule}: {message}" for rule, message in broken)]
        print_result(self.json, table, lines)
        return 1


@dataclass(frozen=True)
class ExploreDesignsCommand:
    """Compare designs: predicted depth range, resolution, force range, signal per newton, field of view, size and cost.

    Every combination of the given values is built, and its twin is pressed by a ball of radius 4 mm. Without any values,
    gels of 1.5, 2.5 and 4 mm with Shore A 5 and 15 are compared, six designs. The camera is moved away as far as the lens
    needs. Nothing here is measured: docs/hardware.md states what each prediction rests on.
    """

    sweep: Annotated[DesignSweep, tyro.conf.arg(name="")] = DesignSweep()
    design_options: Annotated[DesignOptions, tyro.conf.arg(name="")] = DesignOptions()
    workers: WorkersOption = 1
    cluster: ClusterOption = None
    out: Path | None = None
    """Folder for explore.json and a design file of every design. Those of an earlier comparison there are removed, other files
    stay."""
    json: JsonOption = False

    def run(self) -> int:
        """Build and press every design and print the comparison."""
        _require_build123d()
        from tqdm import tqdm

        from ninedtact.parallel_jobs import connect_workers
        from ninedtact_hardware.design_comparison import explore_designs, format_design_comparison

        basis = self.design_options.read_hardware()
        sweep = USUAL_SWEEP if self.sweep == DesignSweep() else self.sweep
        candidates = [*sweep.designs(basis)]
        if self.out is not None:
            self.out.mkdir(parents=True, exist_ok=True)
        with connect_workers(self.workers, self.cluster) as workers:
            explored = explore_designs(candidates, workers)
            done = dict(tqdm(explored, total=len(candidates), unit="design", disable=None, leave=False))
        found = [done[number] for number in range(len(candidates))]
        table: dict[str, Any] = {"designs": [each.to_json_dict() for each in found], "files": self._write_files(found)}
        return print_result(self.json, table, format_design_comparison(found))

    def _write_files(self, found: "list[ExploredDesign]") -> list[str]:
        from ninedtact.atomic_write import write_file_atomically
        from ninedtact_hardware.design_file import hardware_design_to_toml

        if self.out is None:
            return []
        designs = {f"design_{number:02d}.toml": each.design for number, each in enumerate(found, 1) if each.prediction}
        contents = {name: hardware_design_to_toml(design).encode() for name, design in designs.items()}
        table = {"designs": [each.to_json_dict() for each in found]}
        contents["explore.json"] = json.dumps(table, indent=2).encode()
        for name, content in contents.items():
            write_file_atomically(self.out / name, content)
        for stale in self.out.glob("design_[0-9][0-9]*.toml"):
            if stale.name not in contents and stale.stem.removeprefix("design_").isdecimal():
                stale.unlink()
        return [str(self.out / name) for name in contents]


@dataclass(frozen=True)
class ExportHardwareCommand:
    """Write STEP, STL, DXF, drawings, circuit board, bill of materials and images of one sensor into a folder."""

    out: Path
    """Folder to write, whole or not at all. A folder that this command wrote before is replaced."""
    design_options: Annotated[DesignOptions, tyro.conf.arg(name="")] = DesignOptions()
    json: JsonOption = False

    def run(self) -> int:
        """Build the sensor, write the folder and list its contents."""
        _require_build123d()
        from tqdm import tqdm

        from ninedtact_hardware.design_folder import require_replaceable_parts_folder, write_design_folder

        require_replaceable_parts_folder(self.out)
        sensor = self.design_options.build_sensor()
        began = time.monotonic()
        with tqdm(desc="writing parts", unit="file", disable=None, leave=False) as progress:
            manifest = write_design_folder(sensor, self.out, lambda _: progress.update() and None)
        return print_result(self.json, manifest, _format_export_report(self.out, manifest, time.monotonic() - began))


def format_fabrication_warnings(manifest: dict[str, Any]) -> Iterator[str]:
    """Yield why parts of this folder should not be made as they are; nothing for a sound design."""
    from ninedtact_hardware.led_board import describe_redrawing

    if differences := manifest["led_board_differences"]:
        yield f"  NO LED BOARD TO ORDER: {describe_redrawing(differences)}"
    for pair in manifest["interferences"]:
        what = f"{pair['first']} and {pair['second']} overlap by {pair['overlap_mm3']:.2f} mm³"
        yield f"  DO NOT MAKE these parts as they are: {what}"


def _format_export_report(out: Path, manifest: dict[str, Any], seconds: float) -> Iterator[str]:
    yield f"{len(manifest['files'])} files of the {manifest['variant']} design in {out}, in {seconds:.0f} s"
    for folder, use in (
        ("printed", "STL and STEP for the print shop"),
        ("cut", "DXF for the laser cutter, mm, 1:1; README.txt states the thickness of each sheet"),
        ("led_board", "files for the board house; the notes state its thickness, or what to redraw before"),
        ("drawings", "dimensions, SVG and PDF"),
    ):
        yield f"  {folder + '/':12}{use}"
    yield from format_fabrication_warnings(manifest)
    yield f"  open {out / 'bom.html'}; {out / 'check.txt'} has the results of all checks"


@dataclass(frozen=True)
class GuideCommand:
    """Write the fabrication guide of a design: a page in Markdown and an image of the parts after each step."""

    out: Path
    """Folder for fabrication.md and images/; other files there stay."""
    design_options: Annotated[DesignOptions, tyro.conf.arg(name="")] = DesignOptions()
    json: JsonOption = False

    def run(self) -> int:
        """Build the sensor, render its images and write the guide."""
        from tqdm import tqdm

        sensor = self.design_options.build_sensor()
        from ninedtact_hardware.fabrication_guide import write_fabrication_guide

        progress = tqdm(
            write_fabrication_guide(sensor, self.out), desc="drawing", unit="file", disable=None, leave=False
        )
        files = [str(path) for path in progress]
        return print_result(self.json, {"files": files}, [f"{len(files)} files; read {files[-1]}"])


HardwareCommand = (
    Annotated[ExportHardwareCommand, tyro.conf.subcommand("export")]
    | Annotated[BomCommand, tyro.conf.subcommand("bom")]
    | Annotated[CheckHardwareCommand, tyro.conf.subcommand("check")]
    | Annotated[ExploreDesignsCommand, tyro.conf.subcommand("explore")]
    | Annotated[GuideCommand, tyro.conf.subcommand("guide")]
)
"""The subcommands of `ninedtact hardware`."""
DESCRIPTION = "The parts of a sensor: files to make them, bill of materials, checks, designs compared, how to build it."
