"""Recognise kinds of TOML files by their tables: refuse a file for another command, and name that command."""

from __future__ import annotations

from collections.abc import Mapping

from geometry.common.errors import InputError, Words

_SECTIONS = {  # what only files of a kind have; a scene file, which has most of its tables to itself, comes first
    "scene file": {"probe", "tissue", "inclusion", "contact"},
    "calibration file": {"cross_talk_resolved", "offsets_sd"},
    "bench file": {"amplifier", "channels", "reference", "sampling"},
    "design file": {"population", "protocol", "limits", "objective"},
    "sweep file": {"sample", "constraints", "evaluator", "accuracy"},
    "design or sweep file": {"scene", "variables"},
}
_USES = {
    "scene file": "probe-design evaluate, plan or optimize",
    "bench file": "--bench of probe-design read, calibrate or check",
    "calibration file": "--calibration of probe-design read or check",
    "design file": "probe-design optimize",
    "sweep file": "probe-design sweep",
    "design or sweep file": "probe-design optimize or probe-design sweep",
}


def check_kind(data: Mapping[str, object], name: str, kind: str, allowed: str) -> None:
    """Refuse a file that another command reads, and name what reads it.

    Parameters
    ----------
    data
        The tables of the file.
    name
        Name of the file, for the message.
    kind
        The kind of file that the caller reads, a key of ``_SECTIONS``.
    allowed
        What a file of that kind contains, for the message.

    Raises
    ------
    InputError
        The file has tables of another kind, and none of its own.
    """
    if kind == "scene file" and data.keys() == {"inclusion"}:
        raise InputError(name, Words("a file of tumours alone"), f"{allowed}; use --hide of probe-design survey --virtual")
    other = next((file_kind for file_kind, sections in _SECTIONS.items() if sections & data.keys()), kind)
    if other == kind or (kind in ("design file", "sweep file") and other == "design or sweep file"):
        return
    if not _SECTIONS[kind] & data.keys():
        raise InputError(name, Words(f"a {other}"), f"{allowed}; use {_USES[other]}")
