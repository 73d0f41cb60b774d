"""The columns of the tables about the network."""

from collections.abc import Mapping

from shared.table_column import Column

CHAMFER_TRUTH = Column("Chamfer Mesh, truth", "chamfer_surface_m2", 1e4, 2)
FLOOR = Column("floor", "chamfer_floor_m2", 1e4, 2)
SYMMETRIC = Column("error mm, up to symmetry", "error_symmetric_mm", spread=True)
SYMMETRIC_VISIBLE = Column("visible", "error_symmetric_visible_mm")
SYMMETRIC_HIDDEN = Column("hidden", "error_symmetric_hidden_mm")
DRAWN = Column("error as named", "error_all_mm")
HAS_MESH = Column("has a mesh %", "has_mesh", 100, 0)
STRAIN = Column("strain %", "edge_strain", 100, 2)
CROSSINGS_RATE = Column("crossings per 1,000 edges", "crossings_per_1000_edges", digits=2)
CPU = Column("CPU s", "cpu_s", digits=2)

CHAMFER_LAST = Column(
    "Chamfer, last action", "chamfer_pc_m2", 1e4, 2, "before", last=True, spread=True
)
CHAMFER = Column("Chamfer, all actions", "chamfer_pc_m2", 1e4, 2, "before")

LEARNING_COLUMNS: Mapping[str, tuple[Column, ...]] = {
    "network_alone": (
        CHAMFER_LAST, CHAMFER, FLOOR, DRAWN, Column("visible", "error_visible_mm"),
        Column("hidden", "error_hidden_mm"), Column("95 %", "error_all_p95_mm"), SYMMETRIC,
        CHAMFER_TRUTH, STRAIN, CROSSINGS_RATE, HAS_MESH, CPU,
    ),
}  # fmt: skip
LEARNING_TITLES: Mapping[str, str] = {
    "network_alone": "Table 1's other side: the network alone",
}
LEARNING_PAIRED: Mapping[str, tuple[Column, ...]] = {
    "network_alone": (CHAMFER_LAST, SYMMETRIC),
}
