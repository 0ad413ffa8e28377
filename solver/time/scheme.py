"""Time schemes of the generalised-alpha family, Newmark's among them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TimeScheme:
    """Constants of generalised-alpha (Chung and Hulbert, J. Appl. Mech. 60, 1993, Eqs. 2 to 6).

    Equilibrium is M a(1-αm) + C v(1-αf) + K u(1-αf) = f(1-αf), with Newmark's formulas (β, γ) for u
    and v. ``conserving`` takes the contact force as the discrete gradient of its potential. It
    requires equilibrium at mid-step with γ = ½, β = ¼, where a linear body conserves energy too.
    """

    name: str
    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float
    conserving: bool = False

    def __post_init__(self) -> None:
        middle = (self.alpha_m, self.alpha_f, self.beta, self.gamma) == (0.5, 0.5, 0.25, 0.5)
        if self.conserving and not middle:
            raise ValueError(
                "a conserving contact force asks for the average acceleration at mid-step"
            )
        if self.alpha_m > self.alpha_f or self.alpha_f > 0.5:
            raise ValueError("generalised-alpha is stable for alpha_m <= alpha_f <= 1/2 only")

    def effective(self, its_s: float, alpha_1_s: float, beta_s: float) -> tuple[float, float]:
        """c_M and c_K (s²) of a step's effective matrix c_M M + c_K K.

        Their ratio c_M / c_K (1/s²) is the shift of a Krylov basis made for this march.
        """
        weight = 1.0 - self.alpha_f
        return (
            (1.0 - self.alpha_m) + weight * self.gamma * its_s * alpha_1_s,
            weight * (self.gamma * its_s * beta_s + self.beta * its_s * its_s),
        )

    @classmethod
    def average(cls) -> TimeScheme:
        """Average acceleration with equilibrium at mid-step: the default; conserves energy.

        For a linear body it is Newmark's average acceleration. Contact enters by its discrete
        gradient, so a changing contact set does not create energy.
        """
        return cls("average", 0.5, 0.5, 0.25, 0.5, conserving=True)

    @classmethod
    def newmark(cls) -> TimeScheme:
        """Newmark's average acceleration as in most codes: contact at the end of the step."""
        return cls("newmark", 0.0, 0.0, 0.25, 0.5)

    @classmethod
    def generalised(cls, rho_inf: float) -> TimeScheme:
        """Generalised-alpha with spectral radius ``rho_inf`` in [0, 1] at infinite frequency."""
        if not 0.0 <= rho_inf <= 1.0:
            raise ValueError(f"rho_inf must lie between 0 and 1, not {rho_inf}")
        alpha_m = (2.0 * rho_inf - 1.0) / (rho_inf + 1.0)
        alpha_f = rho_inf / (rho_inf + 1.0)
        shift = alpha_m - alpha_f
        return cls(
            f"generalised({rho_inf:g})", alpha_m, alpha_f, 0.25 * (1.0 - shift) ** 2, 0.5 - shift
        )
