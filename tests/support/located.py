"""Results that a camera's thread hands to the event loop, without a picture."""

from altd.measuring.pairing import Pair
from altd.measuring.spot_locator import Located
from altd.measuring.view_check import ViewStatus
from altd.records import Spot

SPOT = Spot(300.0, 200.0, 0.01, 40.0, 150.0)


def located(camera: str, sequence: int, t_ns: int = 0, breaks: int = 0) -> Located:
    """A good spot in one frame."""
    view = ViewStatus(camera, False, None, "", "", False, None, t_ns)
    return Located(camera, sequence, t_ns, SPOT, breaks, SPOT, view)


def paired(*of_cameras: Located) -> Pair[Located]:
    """The results of all cameras at one instant, but for the delays of their times."""
    first = of_cameras[0]
    behind_ns = {one.camera: one.t_ns - first.t_ns for one in of_cameras}
    return Pair(first.sequence, first.t_ns, 0, {one.camera: one for one in of_cameras}, {}, behind_ns)
