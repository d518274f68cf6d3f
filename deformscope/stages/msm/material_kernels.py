"""Warp kernels of `materials`: the fits of clusters with a beta along each axis or with S^p, and the flow of S^p.

They take the place of `general_kernels`' fits; gathering, spreading and what is fitted are the same.
"""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from deformscope.stages.msm.cluster_functions import BY_BETA, BY_THETA, NONE, cluster_functions_for
from deformscope.stages.msm.functions import functions_for
from deformscope.stages.msm.general_kernels import general_kernels_for
from deformscope.stages.msm.lanes import Ints, Sized, lanes_for, module_options, product_for, rows_for
from deformscope.stages.msm.materials import LEAST_FACTOR

HALVINGS = 60
"""Of the share that has to flow, down to rounding."""

SHRINKS = 60
"""Steps of S^p toward its bound; each leaves at most about a tenth of the distance."""


@functools.cache
def material_kernels_for(dim: int, terms: int, scalar: Any, width: int) -> SimpleNamespace:
    """The kernels for `dim` = 2 or 3, `terms` = 2, 3 (linear) or 5, 9 (quadratic), and lanes of `width`."""
    numbers = wp.array(dtype=scalar)
    module = f"deformscope_material_{dim}d_{terms}_{scalar.__name__}_{width}"
    wp.get_module(module).options.update(module_options(scalar))
    kernel = functools.partial(wp.kernel, module=module, enable_backward=False)
    general = general_kernels_for(dim, terms, scalar, width)
    lists_type, gathered, parameter = general.Lists, general.gathered, general.parameter
    lane = lanes_for(width, scalar).lane
    squares = rows_for(dim * dim, width, scalar)
    moments = rows_for(dim * (dim + 1) // 2, width, scalar)
    compliances = rows_for(6 if dim == 3 else 1, width, scalar)
    transforms = rows_for(terms * dim, width, scalar)
    store_square = squares.store
    load_square, load_moment, load_null = squares.load, moments.own, transforms.own
    load_compliance, store_compliance, add_transform = compliances.load, compliances.store, transforms.add
    times_null = product_for(terms, dim, dim, width, scalar)
    cluster = cluster_functions_for(dim, terms, scalar, width)
    turn, turned_part, compliance_part = cluster.turn, cluster.turned_part, cluster.compliance_part
    turn_change, mixed, square_part = cluster.turn_change, cluster.mixed, cluster.square_part
    conserve, conserve_change = cluster.conserve, cluster.conserve_change
    functions = functions_for(dim, scalar)
    square, vec, singular_values = functions.square, functions.vec, functions.singular_values
    zero, one, two = scalar(0.0), scalar(1.0), scalar(2.0)
    least_factor = scalar(LEAST_FACTOR)
    sized = Sized(f"material_{dim}x{terms}x{width}")
    number = f"wp::{scalar.__name__}"
    entries = f"for (int i = 0; i < {dim}; ++i) for (int j = 0; j < {dim}; ++j) for (int l = 0; l < {width}; ++l)"
    along = range(dim)
    squares_c = f"wp::mat_t<{dim * dim}, {width}, {number}>"
    transforms_c = f"wp::mat_t<{terms * dim}, {width}, {number}>"
    moments_c = f"wp::mat_t<{dim * (dim + 1) // 2}, {width}, {number}>"

    @wp.struct
    class Material:
        """What clusters have beyond a fit. plastic, axes: 0 or 1.

        strain: S^p - I by rows, laid out as fields of clusters are; with axes, `beta` holds W and C alike
        """

        plastic: int
        axes: int
        strain: numbers

    # Small matrices of lanes. t, x, c are transposed as in `cluster_functions`; s, w and m are not.

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

    @wp.func
    def fit_one(
        lists: lists_type,
        rest: cluster.FitRest,
        kept: cluster.Kept,
        material: Material,
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
        """A cluster's goal map, as `cluster_functions.fit`, toward R S^p and with C in place of beta."""
        at = (group * lists.clusters + c) * lists.abreast
        stride = lists.cluster_stride
        a_qq = load_moment(rest.a_qq, c, rest.stride, 0)
        if material.axes != 0:
            w = load_square(beta, at, stride)
            a_qq = upper(w)
            change_t = weighted(affine_t, w)
        s = squares.rows()
        if material.plastic != 0:
            s = load_square(material.strain, at, stride)
            change_t = with_plastic(change_t, full(a_qq), s)
        turns = turn(a_qq, change_t)
        turned = turned_part(turns)
        target = turned
        if material.plastic != 0:
            target = on_plastic(turned, s, one)
        if rest.has_null != 0:  # terms that the cluster leaves undetermined follow what it is pulled to
            affine_t = add_transform(affine_t, one, times_null(load_null(rest.null_t, c, rest.stride, 0), target))
        if kept.stride > 0:
            store_square(kept.turned, at, kept.stride, turned, wp.static(width))
            store_compliance(kept.compliance, at, kept.stride, compliance_part(turns), wp.static(width))
        th = parameter(lists, theta, 0, group, c)
        if volume != wp.static(NONE):
            if kept.stride > 0:
                store_square(kept.affine, at, kept.stride, square_part(affine_t), wp.static(width))
            affine_t = conserve(rest, c, 0, affine_t, th, volume, what)
        blend_t = affine_t
        if material.axes != 0:
            blend_t = blended(affine_t, target, load_square(beta, at + wp.static(dim * dim) * stride, stride))
        else:
            b = parameter(lists, beta, beta_stride, group, c)
            if what == wp.static(BY_BETA):
                blend_t = mixed(affine_t, lane(one), target, lane(-one))
            elif what == wp.static(BY_THETA):
                blend_t = mixed(affine_t, b, target, lane())
            else:
                blend_t = mixed(affine_t, b, target, lane(one) - b)
        return blend_t

    @wp.func
    def change_one(
        lists: lists_type,
        rest: cluster.FitRest,
        kept: cluster.Kept,
        material: Material,
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
        """Derivative of `fit_one` along a direction, from what it kept."""
        at = (group * lists.clusters + c) * lists.abreast
        stride = lists.cluster_stride
        if material.axes != 0:
            change_t = weighted(affine_t, load_square(beta, at, stride))
        s = squares.rows()
        if material.plastic != 0:
            s = load_square(material.strain, at, stride)
            change_t = with_plastic(change_t, squares.rows(), s)
        turned = load_square(kept.turned, at, kept.stride)
        change = turn_change(turned, load_compliance(kept.compliance, at, kept.stride), change_t)
        if material.plastic != 0:
            change = on_plastic(change, s, zero)
        if rest.has_null != 0:
            affine_t = add_transform(affine_t, one, times_null(load_null(rest.null_t, c, rest.stride, 0), change))
        if volume != wp.static(NONE):
            before = load_square(kept.affine, at, kept.stride)
            affine_t = conserve_change(rest, c, 0, before, affine_t, parameter(lists, theta, 0, group, c), volume)
        blend_t = affine_t
        if material.axes != 0:
            blend_t = blended(affine_t, change, load_square(beta, at + wp.static(dim * dim) * stride, stride))
        else:
            b = parameter(lists, beta, beta_stride, group, c)
            blend_t = mixed(affine_t, b, change, lane(one) - b)
        return blend_t

    fit_clusters = general.fit_kernel(kernel, "fit_clusters", Material, fit_one)
    fit_changes = general.fit_kernel(kernel, "fit_changes", Material, change_one)

    # Flow

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
        """S^p with its determinant made 1: scaled within what the cluster spans."""
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
        lists: lists_type,
        rest: cluster.FitRest,
        material: Material,
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
        """S^p of each cluster after a share of its S - I has flown (see `materials`), a candidate at a time.

        stop: 1 to stop at the yield strain; moved: largest change of an entry of S^p; size: |S - I|_2 before
        """
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

    return SimpleNamespace(**locals())
