"""Fields of values by blocks of a few, which lie side by side in the processor's vectors."""

from taichi_dem.types import real, ti


def block_field(builder: "ti.FieldsBuilder", blocks: int, lanes: int) -> "ti.Field":
    """A field of so many ``blocks`` of ``lanes`` values, (blocks, lanes)."""
    field = ti.field(real)
    # Only so does the compiler know that the lanes of any block lie side by side.
    builder.dense(ti.i, blocks).dense(ti.j, lanes).place(field)
    return field
