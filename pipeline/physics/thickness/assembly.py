"""Residual and tangent matrix of a plane-stress film on four-node quadrilaterals, over scikit-fem's basis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix
from scipy.sparse.linalg import splu

from schemas.arrays import Float, Int


@dataclass(frozen=True)
class Q4:
    """Gradients and weights of four-node elements.

    `gradients` (n, q, 4, 2) of the shape functions at q quadrature points, `weights` (n, q) areas, `nodes` (n, 4).
    Unknown i of node p has the number 2 p + i.
    """

    gradients: Float
    weights: Float
    nodes: Int
    count: int

    def deformation(self, displacement: Float) -> Float:
        """(n, q, 2, 2) F = 1 + ∂u_i/∂X_J from displacements (count, 2)."""
        local = np.swapaxes(displacement[self.nodes], 1, 2)
        return np.asarray(np.eye(2) + local[:, None] @ self.gradients)

    def forces(self, stress: Float) -> Float:
        """(2 count,) inner nodal forces per undeformed thickness from nominal stresses (n, q, 2, 2)."""
        weighted = np.swapaxes(stress, 2, 3) * self.weights[..., None, None]
        local = (self.gradients @ weighted).sum(axis=1)
        return np.bincount(self._dofs().ravel(), local.ravel(), 2 * self.count).astype(np.float64)

    def matrix(self, tangent: Float) -> csc_matrix:
        """(2 count, 2 count) stiffness from tangents (n, q, 2, 2, 2, 2)."""
        n, q = self.weights.shape
        strain = np.zeros((n, q, 2, 2, 4, 2))  # ∂F_iJ/∂u_bk, k = i only
        for i in range(2):
            strain[:, :, i, :, :, i] = np.swapaxes(self.gradients, 2, 3)
        flat = strain.reshape(n, q, 4, 8)
        weighted = tangent.reshape(n, q, 4, 4) * self.weights[..., None, None]
        local = np.swapaxes(flat.reshape(n, 4 * q, 8), 1, 2) @ (weighted @ flat).reshape(n, 4 * q, 8)
        dofs = self._dofs().reshape(-1, 8)
        rows, columns = np.repeat(dofs, 8, axis=1).ravel(), np.tile(dofs, 8).ravel()
        return coo_matrix((local.ravel(), (rows, columns)), shape=(2 * self.count, 2 * self.count)).tocsc()

    def _dofs(self) -> Int:
        return 2 * self.nodes[:, :, None] + np.arange(2)


def q4(mesh: Any) -> Q4:
    """Shape-function gradients of a `skfem.MeshQuad` at 2 × 2 Gauss points."""
    from skfem import Basis, ElementQuad1

    basis = Basis(mesh, ElementQuad1(), intorder=2)
    gradients = np.stack([np.asarray(basis.basis[a][0].grad) for a in range(4)])  # (4, 2, n, q)
    nodes = np.asarray(basis.element_dofs.T, dtype=np.int64)
    return Q4(np.ascontiguousarray(gradients.transpose(2, 3, 0, 1)), np.asarray(basis.dx), nodes, mesh.p.shape[1])


def solve(matrix: csc_matrix, force: Float, tie: csc_matrix, prescribed: Float) -> Float:
    """Displacement in equilibrium under forces and constraints.

    Parameters
    ----------
    matrix : (m, m) stiffness
    force : (m,) nodal forces
    tie : (m, r) maps the r free unknowns to all m: rigid rods share one unknown, held unknowns have an empty row
    prescribed : (m,) displacement of the held unknowns, 0 elsewhere

    Returns
    -------
    u = tie @ v + prescribed (m,) with tieᵀ (matrix u − force) = 0
    """
    reduced = (tie.T @ matrix @ tie).tocsc()
    right = tie.T @ (force - matrix @ prescribed)
    free = splu(reduced, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(right)
    return np.asarray(tie @ free + prescribed)


def tie_matrix(owner: Int) -> csc_matrix:
    """(m, r) matrix from `owner` (m,): the free unknown that each unknown follows, −1 where it is held."""
    follows = np.flatnonzero(owner >= 0)
    used, columns = np.unique(owner[follows], return_inverse=True)
    return coo_matrix((np.ones(follows.size), (follows, columns)), shape=(owner.size, used.size)).tocsc()
