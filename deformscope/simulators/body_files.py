"""A body's files: for MuJoCo an MJCF with a flex, for Newton a USD, for others VTU and OBJ."""

from pathlib import Path

import numpy as np

from deformscope.arrays import FloatArray, IntArray
from deformscope.stages.simulate.slab_mesh import SlabMesh
from deformscope.stages.simulate.target_fit import TargetParameters

RADIUS_M = 1e-4
"""Radius of a flex: the tip stops this far before its vertices."""
GRAVITY, RAYLEIGH_S = 9.81, 0.01
IMPEDANCE = 0.9999
"""MuJoCo's largest (mjMAXIMP): with less, a contact is soft however stiff its reference is."""


def write_body(
    target: str, folder: Path, mesh: SlabMesh, found: TargetParameters, density: float, timestep_s: float
) -> Path:
    """Write the body with these parameters as the target's own file; its path. An existing file is replaced."""
    usd = target == "newton"
    path = folder / ("slab.usda" if usd else "slab.xml")
    text = _usd(mesh, found, density) if usd else _mjcf(mesh, found, density, timestep_s)
    path.write_text(text, encoding="utf-8")
    return path


def write_meshes(folder: Path, mesh: SlabMesh, moved: FloatArray, found: TargetParameters) -> None:
    """`slab.vtu` with modulus (unless nan), Poisson's ratio, displacement (n, 3) [m] of the last poke; `slab.obj` of
    its surface at rest."""
    (folder / "slab.vtu").write_text(_vtu(mesh, moved, found), encoding="utf-8")
    lines = [f"v {_words(one)}" for one in mesh.vertices] + [f"f {_words(one + 1)}" for one in mesh.outside()]
    (folder / "slab.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _words(values: FloatArray | IntArray) -> str:
    return " ".join(f"{one:.8g}" for one in values.ravel())


def _mjcf(mesh: SlabMesh, found: TargetParameters, density: float, timestep_s: float) -> str:
    """Flexes whose cells are trilinear finite elements, of linear elasticity in their rotated frames: the law of the
    measured modulus. `dof="full"` would be Saint Venant and Kirchhoff's law, which softens as it is pressed. A flex has
    one material: each box of cells of one material is a flex, and neighbours have the nodes between them in common."""
    x, y, z = (0.5 * (np.append(one, 0.0) + np.append(0.0, one)) for one in map(np.diff, mesh.axes))
    mass = (density * x[:, None, None] * y[:, None] * z).ravel()
    free, kept, gravity = mesh.vertices[:, 2] > mesh.axes[2][0], "", -GRAVITY
    if mesh.held is not None:
        free, kept, gravity = ~mesh.held, ' mocap="true"', 0.0
    number = np.arange(len(mesh.vertices)).reshape([len(one) for one in mesh.axes])
    bodies, flexes = [], []
    for one, (place, heavy, moves) in enumerate(zip(mesh.vertices, mass, free, strict=True)):
        inertia = f'<inertial pos="0 0 0" mass="{heavy:.6g}" diaginertia="1e-6 1e-6 1e-6"/>'
        slides = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
        inside = f">{inertia}{slides}" if moves else f"{kept}>"
        bodies.append(f'<body name="n{one}" pos="{_words(place)}"{inside}</body>')
    cell = np.tile(np.arange(mesh.material.size), len(mesh.elements) // mesh.material.size)
    for part, (material, box) in enumerate(mesh.boxes()):
        nodes = number[tuple(slice(side.start, side.stop + 1) for side in box)].ravel()
        within = np.isin(cell, np.arange(mesh.material.size).reshape(mesh.cells)[box])
        elements, size = np.searchsorted(nodes, mesh.elements[within]), " ".join(f"{s.stop - s.start}" for s in box)
        flexes.append(f"""
    <flex name="material{material}_{part}" dim="3" dof="trilinear" cellcount="{size}" radius="{RADIUS_M:g}"
          rgba="{0.3 + 0.6 * (material % 2):g} .7 .4 1" body="{" ".join(["world"] * len(nodes))}"
          node="{" ".join(f"n{one}" for one in nodes)}" vertex="{_words(mesh.vertices[nodes])}"
          element="{_words(elements)}">
      <elasticity young="{found.moduli[material]:.6g}" poisson="{found.poisson:.6g}" damping="{RAYLEIGH_S}"/>
      <contact selfcollide="none" contype="0" condim="1" priority="1" solimp="{IMPEDANCE} {IMPEDANCE} .001"
               solref="{-found.contact:.6g} {-2.0 * np.sqrt(found.contact):.6g}"/>
    </flex>""")
    rows = "\n    ".join(bodies)
    return f"""<mujoco model="slab">
  <!-- The discrete integrator alone is implicit in the elasticity; implicit and implicitfast refuse it. -->
  <option integrator="discrete" solver="CG" timestep="{timestep_s:g}" gravity="0 0 {gravity}"/>
  <worldbody>
    {rows}
  </worldbody>
  <deformable>{"".join(flexes)}
  </deformable>
</mujoco>
"""


def _usd(mesh: SlabMesh, found: TargetParameters, density: float) -> str:
    """A TetMesh with the schemas of deformable bodies that OpenUSD's physics group proposes; they have no word for what
    is glued to the world. Materials are bound to subsets of its cells; Newton's importer takes the first for all."""

    def rows(values: FloatArray | IntArray) -> str:
        return ", ".join("(" + ", ".join(f"{one:.8g}" for one in row) + ")" for row in values)

    foams = "".join(
        f"""
    def Material "Foam{number}" (prepend apiSchemas = ["PhysicsMaterialAPI", "PhysicsVolumeDeformableMaterialAPI"])
    {{
        float physics:youngsModulus = {young:.6g}
        float physics:poissonsRatio = {found.poisson:.6g}
        float physics:density = {density:.6g}
    }}"""
        for number, young in enumerate(found.moduli)
    )
    subsets = "".join(
        f"""
        def GeomSubset "Foam{number}" (prepend apiSchemas = ["MaterialBindingAPI"])
        {{
            uniform token elementType = "tetrahedron"
            uniform token familyName = "materialBind"
            int[] indices = [{", ".join(map(str, np.flatnonzero(mesh.element_material() == number)))}]
            rel material:binding:physics = </Slab/Foam{number}>
        }}"""
        for number in range(len(found.moduli) * bool(found.ratios))
    )
    return f"""#usda 1.0
(
    defaultPrim = "Slab"
    metersPerUnit = 1
    kilogramsPerUnit = 1
    upAxis = "Z"
)
def Xform "Slab" (prepend apiSchemas = ["PhysicsDeformableBodyAPI"])
{{{foams}
    def TetMesh "Cells" (
        prepend apiSchemas = ["PhysicsVolumeDeformableSimAPI", "PhysicsCollisionAPI", "MaterialBindingAPI"]
    )
    {{
        point3f[] points = [{rows(mesh.vertices)}]
        int4[] tetVertexIndices = [{rows(mesh.elements)}]
        rel material:binding:physics = </Slab/Foam0>{subsets}
    }}
}}
"""


def _vtu(mesh: SlabMesh, moved: FloatArray, found: TargetParameters) -> str:
    def array(name: str, kind: str, values: FloatArray | IntArray, parts: int = 1) -> str:
        attributes = f'type="{kind}" Name="{name}" NumberOfComponents="{parts}" format="ascii"'
        return f"<DataArray {attributes}>{_words(values)}</DataArray>"

    count, moduli = len(mesh.elements), np.array(found.moduli)
    cells = array("connectivity", "Int32", mesh.elements)
    cells += array("offsets", "Int32", 4 * np.arange(1, count + 1)) + array("types", "UInt8", np.full(count, 10))
    fields = "".join(
        array(name, "Float64", value)
        for name, value in (("young_pa", moduli[mesh.element_material()]), ("poisson", np.full(count, found.poisson)))
        if np.isfinite(value).all()
    )
    return (
        '<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="0.1"><UnstructuredGrid>\n'
        f'<Piece NumberOfPoints="{len(mesh.vertices)}" NumberOfCells="{count}">\n'
        f"<Points>{array('points', 'Float64', mesh.vertices, 3)}</Points>\n<Cells>{cells}</Cells>\n"
        f"<PointData>{array('displacement_m', 'Float64', moved, 3)}</PointData>\n<CellData>{fields}</CellData>\n"
        "</Piece></UnstructuredGrid></VTKFile>\n"
    )
