"""What a virtual board looks at: a full-resolution source in, pixels as the sensor sends them."""

import numpy as np
from numpy.typing import NDArray

from drivers.noise import Response
from drivers.simulated.readout import Readout
from drivers.simulated.windows import Picture, picture_of
from drivers.source import Annotations, FrameSource
from drivers.usb.frame_header import Window
from pipeline.pixel_formats import BY_CODE


class World:
    """Pictures of a source, read like a sensor reads them.

    One that can be read by windows is made only where the board looks.
    """

    def __init__(
        self, source: FrameSource, *, pixel_format: int, noise: float, seed: int, most_px: int,
        response: Response | None = None,
    ) -> None:  # fmt: skip
        self._source = source
        self.length = source.length
        self.readout = Readout(
            form=BY_CODE[pixel_format], noise=noise, response=response, seed=seed, most_px=most_px
        )
        self._index = -1
        self._picture: Picture = np.empty((0, 0, 3), np.uint8)

    def code(self, window: Window, size_px: tuple[int, int]) -> int:
        """PFNC code of what `render` makes: a crop at odd pixels has a mosaic of another order."""
        return self.readout.form_of(window, size_px).code

    def render(
        self,
        index: int,
        window: Window,
        size_px: tuple[int, int],
        out: NDArray[np.uint8],
        port: int,
    ) -> None:
        """Fill `out` (n,) with the window of a picture, reduced to `size_px`."""
        if index != self._index:
            self._picture, self._index = picture_of(self._source, index), index
        pixels = out.view(self.readout.dtype).reshape(self.readout.shape(size_px))
        self.readout.read(self._picture, window, pixels, seq=index, port=port)

    def payload(
        self, index: int, window: Window, size_px: tuple[int, int], nbytes: int, port: int
    ) -> NDArray[np.uint8]:
        """Return the bytes of a frame, (nbytes,) or (rows, row_bytes) with gaps between the rows.

        They are valid until the next frame of that stream.
        """
        out = np.empty(nbytes, np.uint8)
        self.render(index, window, size_px, out, port)
        return out

    def truth(self, index: int) -> Annotations | None:
        """What is in a picture, where the source knows it."""
        return self._source.truth(index)

    def close(self) -> None:
        """Close the source."""
        self._source.close()
