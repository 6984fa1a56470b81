"""What surface, blocks, side, floor and interfaces send back of the fields that spheres scatter.

Scattered fields are known in closed form anywhere (``solver/inclusions/vector_modes.py``), so that the finite elements never
see the sphere: they are told the tractions and displacements that the field leaves on the tissue's boundary, one azimuthal
order at a time. What comes back to a sphere is told by its work on the sphere's outgoing modes, which is found on the boundary
too, eq. MS.6 of ``boundary_compliance.py``: its regular modes are the next incident field, and reflection is exactly
symmetric.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.resources import check_memory, check_time, has_room
from solver.axisymmetric.base_states import BaseStates
from solver.axisymmetric.dofs import Interface
from solver.axisymmetric.tissue_field import TissueField
from solver.linalg.schur_complements import SchurComplements
from solver.linalg.workspace import current, size
from solver.multiple_scattering.azimuthal_systems import AzimuthalSystems, Harmonic
from solver.multiple_scattering.boundary_compliance import BoundaryData, BoundaryResponse
from solver.multiple_scattering.boundary_edges import Boundary
from solver.multiple_scattering.interior_solution import Interior
from solver.multiple_scattering.layer_samples import LayerSamples
from solver.multiple_scattering.lockstep import Steps
from solver.multiple_scattering.near_exchange import CloseExchange
from solver.multiple_scattering.panels import Panels
from solver.multiple_scattering.rings import AzimuthalGrid
from solver.multiple_scattering.spheres import ScatteringSphere

LESS = "fewer, or further from surface, floor and interfaces, take less"


@dataclass(frozen=True)
class Reflector:
    """The boundary of one probe's tissue, with what each azimuthal order that was asked for answers.

    Attributes:
        states: base states without a sphere.
        interface: between blocks and tissue.
        close: whether spheres may lie too close to the boundary for eq. MS.6, see ``near_exchange.py``.
    """

    states: BaseStates
    interface: Interface
    close: bool = False
    _responses: dict[tuple[int, tuple[int, ...]], BoundaryResponse] = field(default_factory=dict, repr=False)
    _complements: dict[tuple[int, tuple[int, ...]], SchurComplements] = field(default_factory=dict, repr=False)
    _interiors: dict[tuple[int, int], Interior] = field(default_factory=dict, repr=False)
    _kept: dict[int, Harmonic] = field(default_factory=dict, repr=False)
    _data: dict[tuple[int, int], BoundaryData] = field(default_factory=dict, repr=False)
    _panels: dict[int, Panels] = field(default_factory=dict, repr=False)

    def response(self, m: int, layers: tuple[int, ...] = (0,)) -> BoundaryResponse:
        """Return what an order answers to fields in some layers, by number; its system is made when it is asked."""
        if (m, layers) not in self._responses:
            current().make_room(self._harmonics.needed)
            data = BoundaryData.stacked([self._boundary_data(layer, min(m, 1)) for layer in layers])
            complements = self._complements.setdefault((min(m, 2), layers), SchurComplements())
            self._responses[m, layers] = BoundaryResponse(partial(self._harmonics.of_order, m), data, complements)
        return self._responses[m, layers]

    def interior(self, m: int, layer: int = 0, beside: float = 0.0) -> Interior:
        """Return what an order answers inside the tissue to fields in one layer, for spheres that lie close.

        Args:
            m: the order.
            layer: the layer's number.
            beside: bytes that the spheres hold.

        Raises:
            LimitReached: not even one order is within the limit of memory.
        """
        if m not in self._kept:
            self._make_room(beside)
            self._kept[m] = self._harmonics.of_order(m)
        if (m, layer) not in self._interiors:
            recovery = partial(self._harmonics.recovery, m)
            self._interiors[m, layer] = Interior(self._kept[m], self._boundaries[layer], recovery)
        return self._interiors[m, layer]

    def _make_room(self, beside: float) -> None:
        """Make room for one order: where memory is short the last goes, as reflections ask for all of them, again and again."""
        needed = self._harmonics.needed
        current().make_room(needed)
        wanted = current().bytes_held + beside + needed
        if not self._kept:
            check_memory(f"reflections of tumours close to the surface, to other faces or to the probe ({LESS})", wanted)
        elif len(self._kept) > 1 and not has_room(wanted):
            last, _ = self._kept.popitem()
            for key in [key for key in self._interiors if key[0] == last]:
                del self._interiors[key]

    @cached_property
    def _boundaries(self) -> list[Boundary]:
        """Of all layers and of the tissue below them."""
        return [Boundary.of(self.states.model, layer) for layer in range(len(self.states.model.section.interfaces) + 1)]

    @cached_property
    def _field(self) -> TissueField:
        return TissueField(self.states)

    @cached_property
    def _harmonics(self) -> AzimuthalSystems:
        elements = np.unique(np.concatenate([one.elements for one in self._boundaries]))
        return AzimuthalSystems(self.states.model, self.interface, elements)

    def _boundary_data(self, layer: int, m: int) -> BoundaryData:
        """Of a layer, for order 0 or for all others."""
        if (layer, m) not in self._data:
            model, elements = self.states.model, self._harmonics.boundary
            boundary, panels = self._boundaries[layer], self.panels(layer)
            self._data[layer, m] = BoundaryData.of(model, boundary, elements, panels, interface=self.interface, m=m)
        return self._data[layer, m]

    def panels(self, layer: int = 0) -> Panels:
        """Where fields are sampled on a layer's boundary."""
        if layer not in self._panels:
            self._panels[layer] = Panels.of(self.states.model.section, self.states.model.shapes.order, layer)
        return self._panels[layer]

    def exchange(self, spheres: Sequence[ScatteringSphere], rounds: AzimuthalGrid) -> Exchange | CloseExchange:
        """Return what spheres and boundary send to each other; all that does not depend on the fields is found once.

        Args:
            spheres: anywhere in the tissue.
            rounds: angles at which their fields are sampled.

        Raises:
            LimitReached: so many spheres that what is found once takes more memory than is allowed.
        """
        if self.close:
            interior = partial(self.interior, beside=size(list(spheres)))
            return CloseExchange(interior, self._field, interface=self.interface, spheres=spheres, rounds=rounds)
        samples = LayerSamples.of(spheres, self.panels, rounds)
        samples.check_room()
        return Exchange(self, spheres, samples)


@dataclass(frozen=True)
class Exchange:
    """Some spheres before one boundary.

    Attributes:
        reflector: the boundary.
        spheres: they.
        samples: their fields on the boundary.
    """

    reflector: Reflector
    spheres: Sequence[ScatteringSphere]
    samples: LayerSamples

    def reflecting(self, scattered: Sequence[Floats], enough: float, most: int) -> Steps[tuple[list[Floats], int]]:
        """Ask order by order; return the regular coefficients of what comes back to each sphere, m, and how many orders of it.

        Args:
            scattered: outgoing coefficients about each, (modes, k), m.
            enough: work, J: two orders in which fields do less on each other end the sum.
            most: orders at most.

        Raises:
            SolveError: a system could not be solved.
        """
        data = self.samples.amplitudes(scattered)
        answers, k, quiet = np.empty_like(data), scattered[0].shape[1], 0
        for m in range(min(most, len(data))):
            check_time("reflections")
            answers[m] = yield self.reflector.response(m, self.samples.layers), data[m]
            exchanged = (data[m].reshape(-1, k)).T @ answers[m].reshape(-1, k)
            quiet = quiet + 1 if np.abs(exchanged).max() < enough else 0
            if quiet == 2:
                break
        works = self.samples.works(answers[: m + 1])
        return [self._regular(one, work) for one, work in zip(self.spheres, works, strict=True)], m + 1

    def _regular(self, sphere: ScatteringSphere, work: Floats) -> Floats:
        """Coefficients from the work of every outgoing mode: that on the regular mode of its own kind, ``Modes.work``."""
        return np.asarray(work / (-sphere.two_mu * sphere.radius * sphere.modes.work)[:, None])
