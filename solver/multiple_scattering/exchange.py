"""Compute the fields that surface, blocks, side, bottom and interfaces reflect to spheres.

Scattered fields are known in closed form anywhere (``solver/inclusions/vector_modes.py``), so that the finite elements need no
sphere: their loads are the tractions and displacements of the field on the tissue's boundary, one azimuthal order at a time. The
reflected field follows from its work on the sphere's outgoing modes, an integral over the boundary, eq. MS.6 of
``boundary_compliance.py``. Its regular modes are the next incident field, and reflection is exactly symmetric.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.resources import check_memory, check_time, fits_in_memory
from solver.axisymmetric.base_states import BaseStates
from solver.axisymmetric.dofs import Interface
from solver.axisymmetric.tissue_field import TissueField
from solver.linalg.schur_complements import SchurComplements
from solver.linalg.workspace import get_workspace, measure_bytes
from solver.multiple_scattering.azimuthal_systems import AzimuthalSystems, Harmonic
from solver.multiple_scattering.boundary_compliance import BoundaryData, BoundaryResponse
from solver.multiple_scattering.boundary_edges import Boundary
from solver.multiple_scattering.boundary_samples import LayerSamples
from solver.multiple_scattering.close_exchange import CloseExchange
from solver.multiple_scattering.interior_solution import Interior
from solver.multiple_scattering.lockstep import Steps
from solver.multiple_scattering.rings import AzimuthalGrid, Panels
from solver.multiple_scattering.spheres import ScatteringSphere

LESS_MEMORY_HINT = "fewer, or further from surface, bottom and interfaces, take less"


@dataclass(frozen=True)
class Reflector:
    """The boundary of one probe's tissue, with the cached response of each azimuthal order.

    Attributes
    ----------
    states
        Base states without a sphere.
    interface
        How blocks and tissue are tied to each other: bonded or frictionless.
    close
        Whether spheres may lie too close to the boundary for eq. MS.6, see ``close_exchange.py``.
    """

    states: BaseStates
    interface: Interface
    close: bool = False
    _responses: dict[tuple[int, tuple[int, ...]], BoundaryResponse] = field(default_factory=dict, repr=False)
    _complements: dict[tuple[int, tuple[int, ...]], SchurComplements] = field(default_factory=dict, repr=False)
    _interiors: dict[tuple[int, int], Interior] = field(default_factory=dict, repr=False)
    _harmonic_of_order: dict[int, Harmonic] = field(default_factory=dict, repr=False)
    _data: dict[tuple[int, int], BoundaryData] = field(default_factory=dict, repr=False)

    def find_response(self, m: int, layers: tuple[int, ...] = (0,)) -> BoundaryResponse:
        """Return the response of an order to fields in some layers, by number; its system is assembled on first use."""
        if (m, layers) not in self._responses:
            get_workspace().make_room(self._harmonics.bytes_per_order)
            data = BoundaryData.stack([self._find_boundary_data(layer, min(m, 1)) for layer in layers])
            complements = self._complements.setdefault((min(m, 2), layers), SchurComplements())
            self._responses[m, layers] = BoundaryResponse(partial(self._harmonics.assemble_order, m), data, complements)
        return self._responses[m, layers]

    def find_interior(self, m: int, layer: int = 0, beside: float = 0.0) -> Interior:
        """Return the response of an order inside the tissue to fields in one layer, for spheres close to the boundary.

        Parameters
        ----------
        m
            The order.
        layer
            The layer's number.
        beside
            Bytes that the spheres use besides the system.

        Raises
        ------
        LimitReached
            One order already exceeds the memory limit.
        """
        if m not in self._harmonic_of_order:
            self._reserve_memory(beside)
            self._harmonic_of_order[m] = self._harmonics.assemble_order(m)
        if (m, layer) not in self._interiors:
            recovery = partial(self._harmonics.compute_recovery, m)
            self._interiors[m, layer] = Interior(self._harmonic_of_order[m], self._boundaries[layer], recovery)
        return self._interiors[m, layer]

    def _reserve_memory(self, other_bytes: float) -> None:
        """Reserve memory for one more order; if memory is short, drop the last cached order.

        All orders are used in turn, so that dropping the oldest would drop the one that is needed next.
        """
        needed = self._harmonics.bytes_per_order
        get_workspace().make_room(needed)
        # a caller may use a solution that the workspace has dropped already
        total_bytes = get_workspace().measure_with(self) + other_bytes + needed
        if not self._harmonic_of_order:
            check_memory(
                f"reflections of tumours close to the surface, to other faces or to the probe ({LESS_MEMORY_HINT})", total_bytes
            )
        elif len(self._harmonic_of_order) > 1 and not fits_in_memory(total_bytes):
            last, _ = self._harmonic_of_order.popitem()
            for key in [key for key in self._interiors if key[0] == last]:
                del self._interiors[key]

    @cached_property
    def _boundaries(self) -> list[Boundary]:
        """Boundaries of all layers and of the tissue below them."""
        return [Boundary.from_model(self.states.model, layer) for layer in range(len(self.states.model.section.interfaces) + 1)]

    @cached_property
    def _field(self) -> TissueField:
        """The base states as functions of position."""
        return TissueField(self.states)

    @cached_property
    def _harmonics(self) -> AzimuthalSystems:
        """Systems of all azimuthal orders."""
        elements = np.unique(np.concatenate([boundary.elements for boundary in self._boundaries]))
        return AzimuthalSystems(self.states.model, self.interface, elements)

    def _find_boundary_data(self, layer: int, m: int) -> BoundaryData:
        """Return the data matrices of a layer, for order 0 (m = 0) or for all others (m = 1); they are cached."""
        if (layer, m) not in self._data:
            model, elements = self.states.model, self._harmonics.boundary
            boundary, panels = self._boundaries[layer], self._panels[layer]
            self._data[layer, m] = BoundaryData.from_layer(model, boundary, elements, panels, interface=self.interface, m=m)
        return self._data[layer, m]

    @cached_property
    def _panels(self) -> list[Panels]:
        """Points at which fields are sampled on the boundary of each layer."""
        model = self.states.model
        return [Panels.from_section(model.section, model.shapes.order, layer) for layer in range(len(self._boundaries))]

    def build_exchange(self, spheres: Sequence[ScatteringSphere], rounds: AzimuthalGrid) -> Exchange | CloseExchange:
        """Build the exchange of fields between spheres and boundary; all that does not depend on the fields is computed once.

        Parameters
        ----------
        spheres
            Anywhere in the tissue.
        rounds
            Angles at which their fields are sampled.

        Raises
        ------
        LimitReached
            There are so many spheres that this exceeds the memory limit.
        """
        if self.close:
            interior = partial(self.find_interior, beside=measure_bytes(list(spheres)))
            return CloseExchange(interior, self._field, interface=self.interface, spheres=spheres, rounds=rounds)
        samples = LayerSamples.from_spheres(spheres, self._panels, rounds)
        samples.check_memory_limit()
        return Exchange(self, spheres, samples)


@dataclass(frozen=True)
class Exchange:
    """Exchange of fields between some spheres and one boundary.

    Attributes
    ----------
    reflector
        The boundary.
    spheres
        The spheres.
    samples
        Samples of their fields on the boundary.
    """

    reflector: Reflector
    spheres: Sequence[ScatteringSphere]
    samples: LayerSamples

    def iterate_reflection(
        self, scattered: Sequence[Floats], min_work: float, max_orders: int
    ) -> Steps[tuple[list[Floats], int]]:
        """Reflect fields order by order; return each sphere's regular coefficients, in m, and the number of orders.

        These are steps for ``lockstep``: each yields the response of one order with its data, and receives their product.

        Parameters
        ----------
        scattered
            Outgoing coefficients about each sphere, (modes, k), m.
        min_work
            Work, J; two successive orders with less work end the sum.
        max_orders
            Maximum number of orders.

        Raises
        ------
        SolveError
            A system could not be solved.
        """
        data = self.samples.compute_amplitudes(scattered)
        responses, k, negligible_orders = np.empty_like(data), scattered[0].shape[1], 0
        for m in range(min(max_orders, len(data))):
            check_time("reflections")
            responses[m] = yield self.reflector.find_response(m, self.samples.layers), data[m]
            exchanged = (data[m].reshape(-1, k)).T @ responses[m].reshape(-1, k)
            negligible_orders = negligible_orders + 1 if np.abs(exchanged).max() < min_work else 0
            if negligible_orders == 2:
                break
        works = self.samples.compute_work(responses[: m + 1])
        # a coefficient is the work of its outgoing mode on the response, over that on its regular mode, ``Modes.work``
        coefficients = [
            np.asarray(work / (-sphere.two_mu * sphere.radius * sphere.modes.work)[:, None])
            for sphere, work in zip(self.spheres, works, strict=True)
        ]
        return coefficients, m + 1
