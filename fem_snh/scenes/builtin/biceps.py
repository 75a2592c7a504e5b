"""The biceps of Smith et al. 2018, Figure 10, under an elbow flexion."""

from pydantic import PositiveFloat

from fem_snh.scenes import Scene
from fem_snh.scenes.builtin.elbow import elbow


def biceps(cells: int = 30, angle: PositiveFloat = 120.0) -> Scene:
    """A strong arm whose elbow is flexed until the forearm meets the biceps.

    Smith et al. 2018 compare stable Neo-Hookean with ``--material stvk_kikuuwe``.

    Parameters
    ----------
    cells : int
        Cells along the arm: 30 give 8,000 tetrahedra.
    angle : float
        Flexion at load 1 [degrees]; the arm is straight at rest.
    """
    scene = elbow(cells, angle, biceps=0.02, hollow=0.0, thickness=1.25)
    # StVK has no volume term of J alone, of which an element could take the mean. A Hessian that is
    # named has a line search, the paper's method.
    changes = {"name": "biceps", "element": "P2", "steps": 4, "hessian": "adaptive"}
    return scene.model_copy(update=changes | {"predictor": "tangent"})  # a line search's better one
