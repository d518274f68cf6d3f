"""Warp kernels of clusters given as index lists, for points without a lattice; candidates abreast in the lanes.

With a material (`materials`) clusters have a beta along each axis, or a plastic deformation S^p that flows."""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from deformscope.stages.msm.cluster_functions import cluster_functions_for
from deformscope.stages.msm.functions import functions_for
from deformscope.stages.msm.lanes import Ints, Sized, kernel_in, lanes_for, members, rows_for
from deformscope.stages.msm.lattice_kernels import FAR, motion_for
from deformscope.stages.msm.materials import LEAST_FACTOR

HALVINGS = 60
"""Halvings of the share that has to flow, down to rounding."""

SHRINKS = 60
"""Steps of S^p toward its bound; each leaves at most about a tenth of the distance."""


@functools.cache
def gathering_functions_for(dim: int, terms: int, scalar: Any, width: int) -> SimpleNamespace:
    """The functions that gather the moments of a cluster and spread its goal map; arguments as `general_kernels_for`
    has them."""
    numbers = wp.array(dtype=scalar)
    vecs, squares = rows_for(dim, width, scalar), rows_for(dim * dim, width, scalar)
    transforms = rows_for(dim * terms, width, scalar)
    one = scalar(1.0)
    number = f"wp::{scalar.__name__}"

    @wp.struct
    class Lists:
        """Clusters as lists of particles, particles as lists of clusters, and where fields keep them.

        particles, clusters: fields of particles and of clusters have `abreast` candidates at a place, and rows
        `particle_stride` and `cluster_stride` numbers apart; groups of candidates follow one another"""

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

    @wp.struct
    class Given:
        """Parameters of the candidates, and of clusters beyond a fit. plastic, axes: 0 or 1.

        strain: S^p - I by rows, laid out as fields of clusters are; with axes, `beta` holds W and C alike
        beta_stride: see `body.Parameters`"""

        beta: numbers
        beta_stride: int
        theta: numbers
        volume: int
        plastic: int
        axes: int
        strain: numbers

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
        """m plus a cluster's map (stored at `at` of `a`) applied to the basis of one of its particles."""

    @wp.func
    def gathered(lists: Lists, group: int, c: int, u_in: numbers):
        """A cluster's mean displacement, A~ - [I, 0] and A_pq - A_qq (both transposed)."""
        centre = vecs.rows()
        base = group * lists.particles * lists.abreast
        for slot in range(lists.offsets[c], lists.offsets[c + 1]):
            at = base + lists.members[slot] * lists.abreast
            centre = vecs.add(centre, lists.share[slot], vecs.load(u_in, at, lists.particle_stride))
        affine_t = transforms.rows()
        change_t = squares.rows()
        for slot in range(lists.offsets[c], lists.offsets[c + 1]):
            at = base + lists.members[slot] * lists.abreast
            away = vecs.add(vecs.load(u_in, at, lists.particle_stride), -one, centre)
            affine_t = add_weighted(affine_t, lists.weight, slot, away)
            change_t = add_moment(change_t, lists.moment, slot, away)
        return centre, affine_t, change_t

    return members(Lists, Given, gathered, add_map)


@functools.cache
def material_functions_for(dim: int, terms: int, scalar: Any, width: int) -> SimpleNamespace:
    """Small matrices of lanes for `materials`. t, x, c are transposed as in `cluster_functions`; s, w and m are not."""
    squares = rows_for(dim * dim, width, scalar)
    moments = rows_for(dim * (dim + 1) // 2, width, scalar)
    transforms = rows_for(terms * dim, width, scalar)
    sized = Sized(f"material_{dim}x{terms}x{width}")
    number = f"wp::{scalar.__name__}"
    entries = f"for (int i = 0; i < {dim}; ++i) for (int j = 0; j < {dim}; ++j) for (int l = 0; l < {width}; ++l)"
    along = range(dim)
    squares_c = f"wp::mat_t<{dim * dim}, {width}, {number}>"
    transforms_c = f"wp::mat_t<{terms * dim}, {width}, {number}>"
    moments_c = f"wp::mat_t<{dim * (dim + 1) // 2}, {width}, {number}>"

    @sized.func_native(
        f"{moments_c} r; int k = 0; for (int i = 0; i < {dim}; ++i) for (int j = i; j < {dim}; ++j, ++k)"
        f" for (int l = 0; l < {width}; ++l) r.data[k][l] = w.data[i * {dim} + j][l]; return r;"
    )
    def upper(w: squares.rows) -> moments.rows: ...

    @sized.func_native(
        f"{squares_c} r; int k = 0; for (int i = 0; i < {dim}; ++i) for (int j = i; j < {dim}; ++j, ++k)"
        f" for (int l = 0; l < {width}; ++l) r.data[i * {dim} + j][l] = r.data[j * {dim} + i][l] = a.data[k][l];"
        " return r;"
    )
    def full(a: moments.rows) -> squares.rows: ...

    terms_xw = " + ".join(f"x.data[{k * dim} + i][l] * w.data[{k * dim} + j][l]" for k in along)

    @sized.func_native(f"{squares_c} r; {entries} r.data[j * {dim} + i][l] = {terms_xw}; return r;")
    def weighted(x: transforms.rows, w: squares.rows) -> squares.rows:
        """X W, for the linear part X."""

    terms_cs = " + ".join(
        f"(a.data[i * {dim} + {k}][l] + c.data[{k * dim} + i][l]) * s.data[j * {dim} + {k}][l]" for k in along
    )

    @sized.func_native(
        f"{squares_c} r; {entries} r.data[j * {dim} + i][l] = c.data[j * {dim} + i][l] + ({terms_cs}); return r;"
    )
    def with_plastic(c: squares.rows, a: squares.rows, s: squares.rows) -> squares.rows:
        """(a + C) (I + s)^T - a: the moments over rest vectors that have yielded by s."""

    terms_ts = " + ".join(f"t.data[{k * dim} + i][l] * s.data[{k * dim} + j][l]" for k in along)

    @sized.func_native(
        f"{squares_c} r; {entries} r.data[j * {dim} + i][l] = t.data[j * {dim} + i][l]"
        f" + first * s.data[i * {dim} + j][l] + ({terms_ts}); return r;"
    )
    def on_plastic(t: squares.rows, s: squares.rows, first: scalar) -> squares.rows:
        """(I + T) (I + s) - I; with first = 0 its change with T."""

    terms_xc = " + ".join(
        f"(x.data[{k * dim} + i][l] - t.data[{k * dim} + i][l]) * m.data[{k * dim} + j][l]" for k in along
    )

    @sized.func_native(
        f"{transforms_c} r = x; {entries} r.data[j * {dim} + i][l] = t.data[j * {dim} + i][l] + ({terms_xc}); return r;"
    )
    def blended(x: transforms.rows, t: squares.rows, m: squares.rows) -> transforms.rows:
        """T + (X - T) C."""

    return members(
        upper=upper, full=full, weighted=weighted, with_plastic=with_plastic, on_plastic=on_plastic, blended=blended
    )


@functools.cache
def general_kernels_for(dim: int, terms: int, scalar: Any, width: int, material: bool = False) -> SimpleNamespace:
    """The kernels for `dim` = 2 or 3, `terms` = 2, 3 (linear) or 5, 9 (quadratic), and lanes of `width`. material: for
    clusters that have one, with `flow`"""
    numbers = wp.array(dtype=scalar)
    tag = f"{dim}d_{terms}_{scalar.__name__}_{width}"
    kernel = kernel_in(f"{'material' if material else 'general'}_{tag}", scalar)
    Motion = motion_for(scalar)
    lanes = lanes_for(width, scalar)
    lane, own, times, below = lanes.lane, lanes.own, lanes.times, lanes.below
    vecs, squares = rows_for(dim, width, scalar), rows_for(dim * dim, width, scalar)
    moments, transforms = rows_for(dim * (dim + 1) // 2, width, scalar), rows_for(dim * terms, width, scalar)
    load, store, add, scale, row = vecs.load, vecs.store, vecs.add, vecs.scale, vecs.row
    cluster = cluster_functions_for(dim, terms, scalar, width)
    gathering = gathering_functions_for(dim, terms, scalar, width)
    gathered, add_map, Lists, Given = gathering.gathered, gathering.add_map, gathering.Lists, gathering.Given
    of = material_functions_for(dim, terms, scalar, width)
    zero, one = scalar(0.0), scalar(1.0)
    far = scalar(FAR)

    @wp.func
    def parameter(lists: Lists, values: numbers, stride: int, group: int, cluster_index: int):
        """A candidate's parameter, or (stride > 0) that of each cluster."""
        if stride > 0:
            return own(values, group * stride + cluster_index * lists.abreast, 1)
        return own(values, group * lists.abreast, 1)

    def fits(changing: bool, name: str) -> Any:
        """The kernel that fits the clusters, or with `changing` its derivative from stored values. It writes their mean
        displacement (0 in a derivative by a parameter) and blend of rotation and fit (eq. 3.7-3.14, 3.17), with a
        material toward R S^p and with C in place of beta."""

        @wp.func(name=f"{name}_at")
        def blended(
            lists: Lists,
            rest: cluster.FitRest,
            kept: cluster.Kept,
            given: Given,
            group: int,
            c: int,
            affine_t: transforms.rows,
            change_t: squares.rows,
        ):
            at = (group * lists.clusters + c) * lists.abreast
            stride = lists.cluster_stride
            a_qq = moments.own(rest.a_qq, c, rest.stride, 0)
            s = squares.rows()
            if wp.static(material):
                if given.axes != 0:
                    w = squares.load(given.beta, at, stride)
                    a_qq = of.upper(w)
                    change_t = of.weighted(affine_t, w)
                if given.plastic != 0:
                    s = squares.load(given.strain, at, stride)
                    full = of.full(a_qq)
                    if wp.static(changing):
                        full = squares.rows()
                    change_t = of.with_plastic(change_t, full, s)
            if wp.static(changing):
                target = cluster.turned_change(kept, at, change_t)
            else:
                target = cluster.turned(kept, at, wp.static(width), a_qq, change_t)
            if wp.static(material):
                if given.plastic != 0:
                    target = of.on_plastic(target, s, wp.static(zero if changing else one))
                if given.axes != 0:
                    along = squares.load(given.beta, at + wp.static(dim * dim) * stride, stride)
                    return of.blended(cluster.with_null(rest, c, 0, affine_t, target), target, along)
            volume = given.volume
            theta = parameter(lists, given.theta, 0, group, c)
            beta = parameter(lists, given.beta, given.beta_stride, group, c)
            if wp.static(changing):
                return cluster.blend_change(rest, c, 0, kept, at, affine_t, target, beta, theta, volume)
            else:  # noqa: RET505 (a static `if` compiles one of the two)
                return cluster.blend(rest, c, 0, kept, at, wp.static(width), affine_t, target, beta, theta, volume)

        @kernel(name=name)
        def run(
            lists: Lists,
            rest: cluster.FitRest,
            kept: cluster.Kept,
            given: Given,
            u_in: numbers,
            running: Ints,
            maps_out: numbers,
        ):
            group, c = wp.tid()
            if running[group] == 0:
                return
            centre, affine_t, change_t = gathered(lists, group, c, u_in)
            blend_t = blended(lists, rest, kept, given, group, c, affine_t, change_t)
            at = (group * lists.clusters + c) * lists.abreast
            stride = lists.cluster_stride
            store(maps_out, at, stride, centre, wp.static(width))
            transforms.store(maps_out, at + wp.static(dim) * stride, stride, blend_t, wp.static(width))

        return run

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
        """x* of eq. 3.1, 3.2: where the last motion and the push would take a free particle."""
        group, particle = wp.tid()
        at = (group * lists.particles + particle) * lists.abreast
        u, is_free = load(u_in, at, lists.particle_stride), free[particle]
        star = add(u, is_free * motion.going_on, add(u, -one, load(before_in, at, lists.particle_stride)))
        for k in range(wp.static(dim)):
            for l in range(wp.static(width)):
                star[k, l] = star[k, l] + is_free * motion.push[k]
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
        sides: numbers,
        held_axis: int,
        running: Ints,
        # Out:
        out: numbers,
        ran_away: Ints,
    ):
        """Mean goal of each particle over its clusters (eq. 3.15), less where it is; 0 if held.

        pull: 1 / number of clusters, 0 for a held particle; sides, held_axis: see `lattice_kernels`. Stepping,
        eq. 3.11: the new position. A particle that would run away stays, and marks its candidate."""
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
            for i in range(wp.static(dim)):
                if i == held_axis:
                    pulled = vecs.with_row(pulled, i, vecs.row(pulled, i) * sides[particle])
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

    made = members(predict, finish, fits(False, "fit_clusters"), fits(True, "fit_changes"), Lists, Given)
    made.Motion = Motion
    if material:
        made.flow = flow_kernel_for(dim, terms, scalar, width)
    return made


@functools.cache
def flow_kernel_for(dim: int, terms: int, scalar: Any, width: int) -> wp.Kernel:
    """The kernel of the flow of S^p; arguments as `general_kernels_for` has them."""
    numbers = wp.array(dtype=scalar)
    kernel = kernel_in(f"material_{dim}d_{terms}_{scalar.__name__}_{width}", scalar)
    gathering = gathering_functions_for(dim, terms, scalar, width)
    Lists, gathered = gathering.Lists, gathering.gathered
    cluster = cluster_functions_for(dim, terms, scalar, width)
    functions = functions_for(dim, scalar)
    square, vec, singular_values = functions.square, functions.vec, functions.singular_values
    zero, one, two = scalar(0.0), scalar(1.0), scalar(2.0)
    least_factor = scalar(LEAST_FACTOR)

    @wp.func
    def beyond(values: vec, share: scalar, span_count: int):
        """|S - I|_2 that is left when the share of S - I has flown, and S^p is of measure 1 again."""
        product = scalar(1.0)
        for i in range(wp.static(dim)):
            if i < span_count:
                product *= wp.max(one + share * (values[i] - one), least_factor)
        grow = wp.pow(product, one / scalar(span_count))
        most = scalar(0.0)
        for i in range(wp.static(dim)):
            if i < span_count:
                factor = wp.max(one + share * (values[i] - one), least_factor)
                most = wp.max(most, wp.abs(values[i] / factor * grow - one))
        return most

    @wp.func
    def strain_size(plastic: square):
        """|S^p - I|_2."""
        _u, values, _v = singular_values(plastic - wp.identity(n=wp.static(dim), dtype=scalar))
        return values[0]

    @wp.func
    def unit_measure(plastic: square, span_axes: square, span_count: int):
        """S^p with its determinant made 1: scaled within the cluster's span."""
        by = wp.pow(wp.determinant(plastic), -one / scalar(span_count))
        if span_count == wp.static(dim):
            return plastic * by
        return plastic + (by - one) * (plastic * span_axes) * wp.transpose(span_axes)

    @wp.func
    def bounded(plastic: square, span_axes: square, span_count: int, maximum: scalar):
        """S^p with |S^p - I|_2 at most `maximum` and its measure 1: less and less of the step from I to it."""
        size = strain_size(plastic)
        if size <= maximum:
            return plastic
        identity = wp.identity(n=wp.static(dim), dtype=scalar)
        away = plastic - identity
        share = one
        out = identity
        if maximum > zero:
            for _shrink in range(wp.static(SHRINKS)):
                share = share * (maximum / size)
                out = unit_measure(identity + share * away, span_axes, span_count)
                size = strain_size(out)
                if wp.abs(size - maximum) <= scalar(1e-15) * maximum:
                    break
        return out

    @kernel
    def flow(
        lists: Lists,
        rest: cluster.FitRest,
        # In:
        u_in: numbers,
        yield_strain: numbers,
        share: numbers,
        maximum: numbers,
        stop: int,
        running: Ints,
        # Out:
        strain: numbers,
        moved_out: numbers,
        size_out: numbers,
    ):
        """S^p of each cluster after a share of its S - I has flown (see `materials`), a candidate at a time. stop: 1 to
        stop at the yield strain; moved: largest change of an entry of S^p; size: |S - I|_2 before"""
        group, c = wp.tid()
        if running[group] == 0:
            return
        span_count = rest.span_count[c]
        span_axes = rest.span_axes[c]
        _centre, affine_t, _change_t = gathered(lists, group, c, u_in)
        at = (group * lists.clusters + c) * lists.abreast
        stride = lists.cluster_stride
        identity = wp.identity(n=wp.static(dim), dtype=scalar)
        for l in range(wp.static(width)):
            candidate = group * lists.abreast + l
            a = square()
            plastic = square()
            for i in range(wp.static(dim)):
                for j in range(wp.static(dim)):
                    a[i, j] = affine_t[j * wp.static(dim) + i, l]
                    plastic[i, j] = strain[at + (i * wp.static(dim) + j) * stride + l]
                plastic[i, i] = plastic[i, i] + one
            if span_count == wp.static(dim):
                a = (a + identity) * wp.inverse(plastic)
            else:  # only what is determined: the other singular values are 0, and come last
                a = (a * span_axes + span_axes) * wp.transpose(span_axes) * wp.inverse(plastic)
            _u, values, v = singular_values(a)
            size = zero
            for i in range(wp.static(dim)):
                if i < span_count:
                    size = wp.max(size, wp.abs(values[i] - one))
            moved = zero
            if size > yield_strain[candidate]:
                by = share[candidate]
                if stop != 0:
                    high = one
                    if beyond(values, one, span_count) < yield_strain[candidate]:
                        low = zero
                        for _halving in range(wp.static(HALVINGS)):
                            middle = (low + high) / two
                            if beyond(values, middle, span_count) > yield_strain[candidate]:
                                low = middle
                            else:
                                high = middle
                    by = wp.min(by, high)
                change = square()
                for k in range(wp.static(dim)):
                    if k < span_count:
                        factor = wp.max(one + by * (values[k] - one), least_factor)
                        for i in range(wp.static(dim)):
                            for j in range(wp.static(dim)):
                                change[i, j] = change[i, j] + (factor - one) * v[i, k] * v[j, k]
                new = unit_measure(plastic + change * plastic, span_axes, span_count)
                new = bounded(new, span_axes, span_count, maximum[candidate])
                for i in range(wp.static(dim)):
                    for j in range(wp.static(dim)):
                        moved = wp.max(moved, wp.abs(new[i, j] - plastic[i, j]))
                        strain[at + (i * wp.static(dim) + j) * stride + l] = new[i, j] - identity[i, j]
            moved_out[at + l] = moved
            size_out[at + l] = size

    return flow
