"""Light: from a membrane to the picture the sensor's camera takes. The only home of Mitsuba and Dr.Jit, imported when first used."""

from gelsim.optics.bake import light_field, settle_mode
from gelsim.optics.camera import height_map, project
from gelsim.optics.frames import render_frames
from gelsim.optics.render import left_out
from gelsim.optics.variant import VariantChoice, choose_variant

__all__ = ["VariantChoice", "choose_variant", "height_map", "left_out", "light_field", "project", "render_frames", "settle_mode"]
