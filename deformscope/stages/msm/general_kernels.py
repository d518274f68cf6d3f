"""Warp kernels of clusters given as index lists, for points without a lattice; candidates abreast in the lanes."""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from deformscope.stages.msm.cluster_functions import GOAL, cluster_functions_for
from deformscope.stages.msm.lanes import Ints, Sized, lanes_for, module_options, rows_for
from deformscope.stages.msm.lattice_kernels import FAR, motion_for


@functools.cache
def general_kernels_for(dim: int, terms: int, scalar: Any, width: int) -> SimpleNamespace:
    """The kernels for `dim` = 2 or 3, `terms` = 2, 3 (linear) or 5, 9 (quadratic), and lanes of `width`."""
    numbers = wp.array(dtype=scalar)
    module = f"deformscope_general_{dim}d_{terms}_{scalar.__name__}_{width}"
    wp.get_module(module).options.update(module_options(scalar))
    kernel = functools.partial(wp.kernel, module=module, enable_backward=False)
    Motion = motion_for(scalar)
    lanes = lanes_for(width, scalar)
    lane, own, times, below = lanes.lane, lanes.own, lanes.times, lanes.below
    vecs, squares = rows_for(dim, width, scalar), rows_for(dim * dim, width, scalar)
    transforms = rows_for(dim * terms, width, scalar)
    load, store, add, scale, row = vecs.load, vecs.store, vecs.add, vecs.scale, vecs.row
    store_transform = transforms.store
    cluster = cluster_functions_for(dim, terms, scalar, width)
    fit, fit_change = cluster.fit, cluster.fit_change
    one = scalar(1.0)
    far = scalar(FAR)
    number = f"wp::{scalar.__name__}"

    @wp.struct
    class Lists:
        """Clusters as lists of particles, particles as lists of clusters, and where fields keep them.

        particles, clusters: fields of particles and of clusters have `abreast` candidates at a place, and rows
        `particle_stride` and `cluster_stride` numbers apart; a group of candidates follows the other
        """

        abreast: int
        particles: int
        clusters: int
        particle_stride: int
        cluster_stride: int
        offsets: Ints
        members: Ints
        share: numbers  # m / M
        weight: numbers  # from displacements to A~ - [I, 0], `terms` a member
        moment: numbers  # from displacements to A_pq - A_qq, `dim` a member
        row_offsets: Ints
        row_clusters: Ints
        row_basis: numbers  # q~, `terms` an entry

    def outer(name: str, count: int, rows: Any) -> Any:
        """The function m + w outer v for the `count` weights w of one member."""
        sized = Sized(f"{name}_{count}x{dim}x{width}")

        @sized.func_native(
            f"wp::mat_t<{count * dim}, {width}, {number}> r; for (int t = 0; t < {count}; ++t)"
            f" for (int i = 0; i < {dim}; ++i) for (int l = 0; l < {width}; ++l)"
            f" r.data[t * {dim} + i][l] = m.data[t * {dim} + i][l] + w.data[slot * {count} + t] * v.data[i][l];"
            " return r;"
        )
        def add_outer(m: rows, w: numbers, slot: int, v: vecs.rows) -> rows: ...

        return add_outer

    add_weighted = outer("weight", terms, transforms.rows)
    add_moment = outer("moment", dim, squares.rows)

    @wp.func_native(
        f"wp::mat_t<{dim}, {width}, {number}> r = m; for (int t = 0; t < {terms}; ++t)"
        f" for (int i = 0; i < {dim}; ++i) for (int l = 0; l < {width}; ++l)"
        f" r.data[i][l] += w.data[slot * {terms} + t] * a.data[at + (t * {dim} + i) * stride + l]; return r;"
    )
    def add_map(m: vecs.rows, w: numbers, slot: int, a: numbers, at: int, stride: int) -> vecs.rows:
        """m plus what a cluster's map (kept at `at` of `a`) makes of the basis of one of its particles."""

    @wp.func
    def parameter(lists: Lists, values: numbers, stride: int, group: int, cluster_index: int):
        """A candidate's parameter, or (stride > 0) that of each cluster."""
        if stride > 0:
            return own(values, group * stride + cluster_index * lists.abreast, 1)
        return own(values, group * lists.abreast, 1)

    @wp.func
    def gathered(lists: Lists, group: int, c: int, u_in: numbers):
        """A cluster's mean displacement, A~ - [I, 0] and A_pq - A_qq (both transposed)."""
        centre = vecs.rows()
        base = group * lists.particles * lists.abreast
        for slot in range(lists.offsets[c], lists.offsets[c + 1]):
            at = base + lists.members[slot] * lists.abreast
            centre = add(centre, lists.share[slot], load(u_in, at, lists.particle_stride))
        affine_t = transforms.rows()
        change_t = squares.rows()
        for slot in range(lists.offsets[c], lists.offsets[c + 1]):
            at = base + lists.members[slot] * lists.abreast
            away = add(load(u_in, at, lists.particle_stride), -one, centre)
            affine_t = add_weighted(affine_t, lists.weight, slot, away)
            change_t = add_moment(change_t, lists.moment, slot, away)
        return centre, affine_t, change_t

    def fit_of_cluster(changing: bool, name: str) -> Any:
        """The function `fit` of one of the clusters, or `changing` its derivative; without a material of its own."""

        @wp.func(name=name)
        def fit_one(
            lists: Lists,
            rest: cluster.FitRest,
            kept: cluster.Kept,
            material: int,
            group: int,
            c: int,
            affine_t: transforms.rows,
            change_t: squares.rows,
            beta: numbers,
            beta_stride: int,
            theta: numbers,
            volume: int,
            what: int,
        ):
            at = (group * lists.clusters + c) * lists.abreast
            b = parameter(lists, beta, beta_stride, group, c)
            t = parameter(lists, theta, 0, group, c)
            if wp.static(changing):
                return fit_change(rest, c, 0, kept, at, affine_t, change_t, b, t, volume)
            else:  # noqa: RET505 (a static `if` compiles one of the two)
                return fit(rest, c, 0, kept, at, wp.static(width), affine_t, change_t, b, t, volume, what)

        return fit_one

    def fit_kernel(kernel: Any, name: str, material_type: Any, fit_of: Any) -> Any:
        """The kernel that gathers the moments of a cluster, fits them by `fit_of`, and leaves its goal map."""

        @kernel(name=name)
        def fits(
            lists: Lists,
            rest: cluster.FitRest,
            kept: cluster.Kept,
            material: material_type,
            # In:
            u_in: numbers,
            beta: numbers,
            beta_stride: int,
            theta: numbers,
            volume: int,
            what: int,
            running: Ints,
            # Out:
            maps_out: numbers,
        ):
            """Mean displacement (0 in a derivative by a parameter); blend of rotation and fit (eq. 3.7-3.14, 3.17)."""
            group, c = wp.tid()
            if running[group] == 0:
                return
            centre, affine_t, change_t = gathered(lists, group, c, u_in)
            blend_t = fit_of(
                lists, rest, kept, material, group, c, affine_t, change_t, beta, beta_stride, theta, volume, what
            )
            if what != wp.static(GOAL):
                centre = vecs.rows()
            at = (group * lists.clusters + c) * lists.abreast
            stride = lists.cluster_stride
            store(maps_out, at, stride, centre, wp.static(width))
            store_transform(maps_out, at + wp.static(dim) * stride, stride, blend_t, wp.static(width))

        return fits

    fit_clusters = fit_kernel(kernel, "fit_clusters", int, fit_of_cluster(False, "fit_one"))
    fit_changes = fit_kernel(kernel, "fit_changes", int, fit_of_cluster(True, "change_one"))

    @wp.func
    def ahead(lists: Lists, u: vecs.rows, before_in: numbers, motion: Motion, free: scalar, at: int):
        """x* of eq. 3.1, 3.2: where the last motion and the push would take a free particle."""
        moved = add(u, free * motion.going_on, add(u, -one, load(before_in, at, lists.particle_stride)))
        for k in range(wp.static(dim)):
            for l in range(wp.static(width)):
                moved[k, l] = moved[k, l] + free * motion.push[k]
        return moved

    @kernel
    def predict(
        lists: Lists,
        # In:
        u_in: numbers,
        before_in: numbers,
        motion: Motion,
        free: numbers,
        # Out:
        star_out: numbers,
    ):
        """x* of eq. 3.1, 3.2."""
        group, particle = wp.tid()
        at = (group * lists.particles + particle) * lists.abreast
        u = load(u_in, at, lists.particle_stride)
        star = ahead(lists, u, before_in, motion, free[particle], at)
        store(star_out, at, lists.particle_stride, star, wp.static(width))

    @kernel
    def finish(
        lists: Lists,
        # In:
        maps_in: numbers,
        u_in: numbers,
        star_in: numbers,
        motion: Motion,
        pull: numbers,
        running: Ints,
        # Out:
        out: numbers,
        ran_away: Ints,
    ):
        """Mean goal of each particle over its clusters (eq. 3.15), less where it is; 0 if held.

        pull: 1 / number of clusters, 0 for a held particle. Stepping, eq. 3.11: the new position. A particle
        that would run away stays, and marks its candidate.
        """
        group, particle = wp.tid()
        if running[group] == 0:
            return
        at = (group * lists.particles + particle) * lists.abreast
        star = load(star_in, at, lists.particle_stride)
        total = vecs.rows()
        for slot in range(lists.row_offsets[particle], lists.row_offsets[particle + 1]):
            c = (group * lists.clusters + lists.row_clusters[slot]) * lists.abreast
            total = add(total, one, add(load(maps_in, c, lists.cluster_stride), -one, star))
            total = add_map(
                total, lists.row_basis, slot, maps_in, c + wp.static(dim) * lists.cluster_stride, lists.cluster_stride
            )
        pulled = scale(total, lane(pull[particle]))
        if motion.stepping == 0:
            store(out, at, lists.particle_stride, pulled, wp.static(width))
        else:
            new = add(star, motion.alpha, pulled)
            length2 = lane()
            for i in range(wp.static(dim)):
                length2 += times(row(new, i), row(new, i))
            if below(length2, far * far) == 0:
                u = load(u_in, at, lists.particle_stride)
                for l in range(wp.static(width)):
                    if not (length2[l] < far * far):
                        ran_away[group * lists.abreast + l] = 1
                        for i in range(wp.static(dim)):
                            new[i, l] = u[i, l]
            store(out, at, lists.particle_stride, new, wp.static(width))

    return SimpleNamespace(**locals())
