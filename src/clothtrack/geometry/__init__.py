"""Pure functions on arrays: meshes, cameras, visibility, distances, area, quality of a mesh."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack.geometry.camera import Camera
    from clothtrack.geometry.chamfer import one_way, two_way
    from clothtrack.geometry.closest_point import closest_on_mesh, distance_to_mesh
    from clothtrack.geometry.coverage import projected_area
    from clothtrack.geometry.devices import quiet_warp
    from clothtrack.geometry.mesh import ClothMesh
    from clothtrack.geometry.quality import close_pairs, crossings, edge_strain
    from clothtrack.geometry.sampling import sample_surface
    from clothtrack.geometry.visibility import Rasterizer, VisibilityCheck, visible_vertices
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = [
    "Camera",
    "ClothMesh",
    "Rasterizer",
    "VisibilityCheck",
    "close_pairs",
    "closest_on_mesh",
    "crossings",
    "distance_to_mesh",
    "edge_strain",
    "one_way",
    "projected_area",
    "quiet_warp",
    "sample_surface",
    "two_way",
    "visible_vertices",
]
