"""A fixed tour of the field: frame number in, ROI window out (the paper's round robin)."""

from pipeline.messages import Geometry


def scan_window(seq: int, geometry: Geometry) -> tuple[int, int, int, int]:
    """Window of frame `seq`: rows of ROI-sized tiles from the top left, over and over.

    Tiles overlap evenly where the field is no multiple of the ROI.

    >>> g = Geometry(width_px=100, height_px=40, roi_width_px=50, roi_height_px=20)
    >>> [scan_window(k, g) for k in range(3)]
    [(0, 0, 50, 20), (50, 0, 100, 20), (0, 20, 50, 40)]
    """
    columns = -(-geometry.width_px // geometry.roi_width_px)
    rows = -(-geometry.height_px // geometry.roi_height_px)
    row, column = divmod(seq % (columns * rows), columns)
    left = _tile(column, columns, geometry.width_px - geometry.roi_width_px, geometry)
    top = _tile(row, rows, geometry.height_px - geometry.roi_height_px, geometry)
    return left, top, left + geometry.roi_width_px, top + geometry.roi_height_px


def _tile(index: int, tiles: int, free_px: int, geometry: Geometry) -> int:
    return geometry.aligned(round(index * free_px / max(tiles - 1, 1)))
