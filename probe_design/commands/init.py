"""The command `init`: write a first scene or design file, with a comment on each line, from the answers to a few questions."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Annotated, Literal

import click

from geometry.common.errors import InputError
from geometry.common.files import write_text
from geometry.common.text_files import parse_tables
from geometry.scenes.quantities import LENGTH_QUANTITY, THICKNESS_QUANTITY
from geometry.scenes.scene import Scene
from geometry.scenes.units import MODULUS_QUANTITY, Quantity
from probe_design.commands.fields import Force
from probe_design.commands.output import print_json
from probe_design.commands.request import Option, Request

FORCE_QUANTITY = Quantity("force", "N", "N", 1e-6, 1e3)
INNER_RADIUS_RELATIVE = 0.6  # of the outer radius: both blocks have a third of the end area and more
INNER_MATERIAL, OUTER_MATERIAL = "dragon-skin-30", "ecoflex-00-30"  # the stiffer one inside: the ratio depends most on a tumour


@dataclass(frozen=True)
class Question:
    """One question.

    Attributes
    ----------
    key
        Of the answer in the file's template.
    text
        The question.
    default
        The answer where there is no terminal, or nothing is typed.
    quantity
        What the answer is.
    """

    key: str
    text: str
    default: str
    quantity: Quantity

    def ask(self, default: str) -> str:
        """Return the answer as it was typed, asked for again until it is such a quantity."""
        return str(click.prompt(self.text, default, value_proc=self._check, err=True))

    def _check(self, answer: str) -> str:
        try:
            self.quantity.parse(answer.strip())
        except ValueError as fault:
            raise click.BadParameter(f"{self.quantity.allowed} ({fault}).") from None
        return answer.strip()


TISSUE_QUESTIONS = (
    Question("tissue_modulus", "Young's modulus of the tissue", "8 kPa", MODULUS_QUANTITY),
    Question("tissue_depth", "Depth of the tissue down to bone or table", "40 mm", LENGTH_QUANTITY),
    Question("skin_thickness", "Thickness of the skin, 0 mm for none", "2 mm", THICKNESS_QUANTITY),
    Question("skin_modulus", "Young's modulus of the skin", "60 kPa", MODULUS_QUANTITY),
)
TUMOUR_QUESTIONS = (
    Question("diameter", "Diameter of the tumour", "12 mm", LENGTH_QUANTITY),
    Question("depth", "Depth of its centre", "14 mm", LENGTH_QUANTITY),
    Question("tumour_modulus", "Young's modulus of the tumour", "60 kPa", MODULUS_QUANTITY),
)
POPULATION_QUESTIONS = (
    Question("low_diameter", "Diameter of the smallest tumour", "8 mm", LENGTH_QUANTITY),
    Question("diameter", "Diameter of the largest", "15 mm", LENGTH_QUANTITY),
    Question("low_depth", "Depth of the centre of the shallowest", "10 mm", LENGTH_QUANTITY),
    Question("depth", "Depth of the centre of the deepest", "25 mm", LENGTH_QUANTITY),
    Question("low_tumour_modulus", "Young's modulus of the softest", "40 kPa", MODULUS_QUANTITY),
    Question("tumour_modulus", "Young's modulus of the stiffest", "120 kPa", MODULUS_QUANTITY),
)
PROBE_QUESTIONS = (
    Question("outer_diameter", "Largest outer diameter of the probe", "20 mm", LENGTH_QUANTITY),
    Question("force", "Force on the probe", "0.3 N", FORCE_QUANTITY),
)
SKIN_TABLE = Template("""
[[${table}tissue.layer]]  # the skin
thickness = "$skin_thickness"
youngs_modulus = "$skin_modulus"
poisson_ratio = 0.45
""")


class InitRequest(Request):
    """Write a commented scene or design file to begin with.

    A scene describes a probe on tissue over one tumour: `probe-design evaluate` predicts its signals. A design describes the
    tumours to be found and the limits: `probe-design optimize` searches a probe for them. In a terminal a few questions are
    asked, each with an answer to take over by Enter; elsewhere these answers are written. Every key of a design file:
    `probe-design optimize --template`.
    """

    output: Annotated[Path | str | None, Option("The file to write.", "-o/--output", left_out="scene.toml or design.toml")] = None
    kind: Annotated[Literal["scene", "design"] | None, Option("What the file describes.", left_out="asked; else scene")] = None
    force: Force = False

    def run(self) -> None:
        """Ask, check that the file is one that can be read, write it, and say what to do with it."""
        on_terminal = sys.stdin is not None and sys.stdin.isatty()
        if self.output is not None:
            self._check_output(Path(self.output))  # before any question
        kind = self.kind or (_ask_kind() if on_terminal else "scene")
        path = Path(self.output or f"{kind}.toml")
        self._check_output(path)
        questions = (*TISSUE_QUESTIONS, *(TUMOUR_QUESTIONS if kind == "scene" else POPULATION_QUESTIONS), *PROBE_QUESTIONS)
        answers, text = ask_all(kind, questions) if on_terminal else build_default_file(kind, questions)
        command = "evaluate" if kind == "scene" else "optimize -o out"
        write_text(path, text)
        if self.as_json:
            print_json({"file": str(path), "kind": kind, "answers": answers})
        else:
            print(f"wrote {path}; next: probe-design {command} {path}")

    def _check_output(self, path: Path) -> None:
        """Raise ``InputError`` where the file exists already, or where its folder does not."""
        if path.exists() and not self.force:
            raise InputError("output", str(path), "a file that does not exist yet, or --force to replace it")
        if not path.parent.is_dir():
            raise InputError("output", str(path), f"a file in a folder that exists; {str(path.parent)!r} is none")


def ask_all(kind: str, questions: tuple[Question, ...]) -> tuple[dict[str, str], str]:
    """Return answers that fit together, and the file's text; where they contradict each other they are asked for again."""
    typed = {question.key: question.default for question in questions}
    while True:
        for question in questions:
            if question.key != "skin_modulus" or THICKNESS_QUANTITY.parse(typed["skin_thickness"]) > 0:
                typed[question.key] = question.ask(typed[question.key])
        answers = _drop_absent_skin(typed)
        try:
            return answers, build_file_text(kind, answers)
        except InputError as fault:
            click.echo(f"Error: {fault}. Once more; Enter keeps an answer.", err=True)


def build_default_file(kind: str, questions: tuple[Question, ...]) -> tuple[dict[str, str], str]:
    """Return the answers that Enter takes over, and the file's text."""
    answers = {question.key: question.default for question in questions}
    return answers, build_file_text(kind, answers)


def _drop_absent_skin(answers: dict[str, str]) -> dict[str, str]:
    """Return the answers without the skin's modulus where there is no skin."""
    absent = THICKNESS_QUANTITY.parse(answers["skin_thickness"]) == 0
    return {key: answer for key, answer in answers.items() if not (absent and key == "skin_modulus")}


def build_file_text(kind: str, answers: dict[str, str]) -> str:
    """Return the text of a scene or design file, checked by reading it.

    Parameters
    ----------
    kind
        "scene" or "design".
    answers
        Quantities as texts with units, by the keys of the questions; without "skin_modulus" there is no skin.

    Raises
    ------
    InputError
        The answers contradict each other, such as a tumour larger than its depth allows.
    """
    from probe_design.populations.design_file import design_from_dict

    table = "" if kind == "scene" else "scene."
    outer_radius = LENGTH_QUANTITY.parse(answers["outer_diameter"]) / 2
    entries = answers | {
        "table": table,
        "outer_radius": f"{outer_radius * 1e3:.6g} mm",
        "inner_radius": f"{round(INNER_RADIUS_RELATIVE * outer_radius * 1e4) / 10:.6g} mm",
        "inner_material": INNER_MATERIAL,
        "outer_material": OUTER_MATERIAL,
        "skin": SKIN_TABLE.substitute(answers, table=table) if "skin_modulus" in answers else "",
    }
    names = ["init_probe.toml.in"] if kind == "scene" else ["init_design.toml.in", "init_probe.toml.in"]
    text = "\n".join(Template(_read_data(name)).substitute(entries) for name in names)
    if kind == "scene":
        Scene.from_toml(text, "the answers")
    else:
        design_from_dict(parse_tables(text, "the answers", "a design file"), units_required=True)
    return text


def _read_data(name: str) -> str:
    """Return the text of a file of this package's data."""
    return files("probe_design.data").joinpath(name).read_text(encoding="utf-8")


def _ask_kind() -> str:
    """Ask which kind of file to write."""
    text = "One probe (scene), or the search for one (design)?"  # within 80 columns, with choices and default
    return str(click.prompt(text, "design", type=click.Choice(["scene", "design"]), err=True))
