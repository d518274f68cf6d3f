"""Warp functions that fit one cluster in every lane, and their derivatives: common parts of lattice and general
kernels.

All matrices are transposed (rows are those of the fit's basis), so that the moments of a lattice multiply from the
right. Displacements are in particle spacings."""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from deformscope.stages.msm.functions import functions_for
from deformscope.stages.msm.lanes import Ints, VectorC, lanes_for, members, product_for, rows_for
from deformscope.stages.msm.reference import NO_ROTATION, Volume

NONE, SCALE, PROJECT = 0, 1, 2
"""Volume conservation: none (theta = 0), Thesis eq. 3.17, or the projection onto the rest volume."""

VOLUMES: dict[Volume, int] = {"scale": SCALE, "project": PROJECT}

NEWTON_STEPS = 8


@functools.cache
def cluster_functions_for(dim: int, terms: int, scalar: Any, width: int) -> SimpleNamespace:
    """The functions for `dim` = 2 or 3, `terms` = 2, 3 (linear) or 5, 9 (quadratic)."""
    numbers = wp.array(dtype=scalar)
    lanes = lanes_for(width, scalar)
    lane, least = lanes.lane, lanes.least
    moment_count = dim * (dim + 1) // 2
    compliance_count = moment_count if dim == 3 else 1
    square_count = dim * dim
    squares = rows_for(square_count, width, scalar)
    compliances = rows_for(compliance_count, width, scalar)
    moments = rows_for(moment_count, width, scalar)
    transforms = rows_for(terms * dim, width, scalar)
    turns = rows_for(square_count + compliance_count + 1, width, scalar)
    times_null = product_for(terms, dim, dim, width, scalar)
    functions = functions_for(dim, scalar)
    frames = rows_for(2 * square_count + dim + 1, width, scalar)
    square, vec, turn_one = functions.square, functions.vec, functions.turn
    denominator_of, project, project_change = functions.volume_denominator, functions.project, functions.project_change
    transform = wp.types.matrix(shape=(dim, terms), dtype=scalar)
    zero, one = scalar(0.0), scalar(1.0)
    number = f"wp::{scalar.__name__}"
    c = VectorC(width, scalar)
    each = f"for (int l = 0; l < {width}; ++l)"
    # the rotation is accepted when its gradient is this small against the moments; else the eigenvector decides
    accept = 1e-12 if scalar is wp.float64 else 3e-6

    def matrix_c(rows: int) -> str:
        return f"wp::mat_t<{rows}, {width}, {number}>"

    @wp.struct
    class FitRest:
        """Constants: `stride` between rows of a quantity, `step` 1 if each lane has its own, else 0."""

        a_qq: numbers  # upper triangle of the normalised rest moments
        null_t: numbers  # what of the basis a cluster leaves undetermined, transposed; empty if nothing
        has_null: int
        span_axes: wp.array(dtype=square)
        span_count: Ints
        root: wp.array(dtype=square)  # see `reference.RestCluster`; one for each cluster that has its own rest
        lift: wp.array(dtype=transform)
        stride: int

    @wp.struct
    class Kept:
        """Stored values of a fit for its derivative: R - I (transposed), the compliance of the rotation, and of a
        volume conserved by projection the frame: u, v, stretch and mu of `functions.project`."""

        turned: numbers
        compliance: numbers
        frame: numbers
        stride: int

    @wp.func_native(
        f"""
    {matrix_c(6)} r;
    {each} {{
        const {number} trace = a.data[0][l] + a.data[2][l];
        const {number} s = c.data[1][l] - c.data[2][l];
        const {number} k = trace + c.data[0][l] + c.data[3][l];
        const {number} size = wp::sqrt(s * s + k * k);
        const bool determined = size > {number}({NO_ROTATION}) * trace;
        const {number} safe = determined ? size : {number}(1);
        const {number} reach = k > 0 ? k + safe : {number}(1);
        const {number} cosine = determined ? (k > 0 ? -s * s / (safe * reach) : (k - safe) / safe) : {number}(0);
        const {number} sine = determined ? s / safe : {number}(0);
        r.data[0][l] = cosine;
        r.data[1][l] = sine;
        r.data[2][l] = -sine;
        r.data[3][l] = cosine;
        r.data[4][l] = determined ? 1 / safe : {number}(0);
        r.data[5][l] = 1;
    }}
    return r;"""
    )
    def turn_2d(a: moments.rows, c: squares.rows) -> turns.rows:
        """R - I of eq. 3.9 in the plane (transposed), the compliance of its angle, and 1. See `functions.turn_2d`. a:
        rest moments A_qq (upper triangle), c: A_pq - A_qq (transposed)"""

    turned_b = """
            const V w = q[0], x = q[1], y = q[2], z = q[3];
            const V d00 = -2 * (y * y + z * z), d11 = -2 * (x * x + z * z), d22 = -2 * (x * x + y * y);
            const V d01 = 2 * (x * y - w * z), d10 = 2 * (x * y + w * z);
            const V d02 = 2 * (x * z + w * y), d20 = 2 * (x * z - w * y);
            const V d12 = 2 * (y * z - w * x), d21 = 2 * (y * z + w * x);
            // B = R^T F = F + D^T F
            const V t01 = d00 * f01 + d10 * f11 + d20 * f21, t10 = d01 * f00 + d11 * f10 + d21 * f20;
            const V t02 = d00 * f02 + d10 * f12 + d20 * f22, t20 = d02 * f00 + d12 * f10 + d22 * f20;
            const V t12 = d01 * f02 + d11 * f12 + d21 * f22, t21 = d02 * f01 + d12 * f11 + d22 * f21;
            const V b00 = f00 + d00 * f00 + d10 * f10 + d20 * f20;
            const V b11 = f11 + d01 * f01 + d11 * f11 + d21 * f21;
            const V b22 = f22 + d02 * f02 + d12 * f12 + d22 * f22;"""
    rest_b = """
            const V w = 1, x = 0, y = 0, z = 0;
            const V d00 = 0, d10 = 0, d20 = 0, d01 = 0, d11 = 0, d21 = 0, d02 = 0, d12 = 0, d22 = 0;
            const V t01 = 0, t10 = 0, t02 = 0, t20 = 0, t12 = 0, t21 = 0;
            const V b00 = f00, b11 = f11, b22 = f22;"""

    def of(name: str, row: int | str) -> str:
        return c.at(f"{name}.data[{row}][0]")

    def evaluation(b: str) -> str:
        """The gradient and the next quaternion of all lanes; b: B at the present one."""
        return f"""
        {{
            const V c00 = {of("c", 0)}, c10 = {of("c", 1)}, c20 = {of("c", 2)};
            const V c01 = {of("c", 3)}, c11 = {of("c", 4)}, c21 = {of("c", 5)};
            const V c02 = {of("c", 6)}, c12 = {of("c", 7)}, c22 = {of("c", 8)};
            const V f00 = {of("a", 0)} + c00, f01 = {of("a", 1)} + c01, f02 = {of("a", 2)} + c02;
            const V f10 = {of("a", 1)} + c10, f11 = {of("a", 3)} + c11, f12 = {of("a", 4)} + c12;
            const V f20 = {of("a", 2)} + c20, f21 = {of("a", 4)} + c21, f22 = {of("a", 5)} + c22;{b}
            // gradient: axial(B); the rest part of F is symmetric and drops out
            const V g0 = c21 - c12 + t21 - t12, g1 = c02 - c20 + t02 - t20, g2 = c10 - c01 + t10 - t01;
            const V h00 = b11 + b22, h11 = b00 + b22, h22 = b00 + b11;
            const V h01 = (f01 + t01 + f10 + t10) / -2, h02 = (f02 + t02 + f20 + t20) / -2;
            const V h12 = (f12 + t12 + f21 + t21) / -2;
            const V m00 = h11 * h22 - h12 * h12, m01 = h02 * h12 - h01 * h22, m02 = h01 * h12 - h02 * h11;
            const V m11 = h00 * h22 - h02 * h02, m12 = h01 * h02 - h00 * h12, m22 = h00 * h11 - h01 * h01;
            const V det = h00 * m00 + h01 * m01 + h02 * m02;
            const V inverse = 1 / det;
            const V v0 = (m00 * g0 + m01 * g1 + m02 * g2) * inverse / 2;
            const V v1 = (m01 * g0 + m11 * g1 + m12 * g2) * inverse / 2;
            const V v2 = (m02 * g0 + m12 * g1 + m22 * g2) * inverse / 2;
            const Int good = (g0 * g0 + g1 * g1 + g2 * g2 <= limit * limit * size2) & (h00 > 0) & (m22 > 0)
                & (det > (V){number}({NO_ROTATION}) * h00 * h11 * h22);
            {of("r", 0)} = d00; {of("r", 1)} = d10; {of("r", 2)} = d20;
            {of("r", 3)} = d01; {of("r", 4)} = d11; {of("r", 5)} = d21;
            {of("r", 6)} = d02; {of("r", 7)} = d12; {of("r", 8)} = d22;
            {of("r", 9)} = m00 * inverse; {of("r", 10)} = m01 * inverse; {of("r", 11)} = m02 * inverse;
            {of("r", 12)} = m11 * inverse; {of("r", 13)} = m12 * inverse; {of("r", 14)} = m22 * inverse;
            {of("r", 15)} = good ? (V)1 : (V)0;
            settled = {c.all("good")};
            const V nw = w - x * v0 - y * v1 - z * v2, nx = x + w * v0 + y * v2 - z * v1;
            const V ny = y + w * v1 + z * v0 - x * v2, nz = z + w * v2 + x * v1 - y * v0;
            const V shrink = 1 / {c.root("nw * nw + nx * nx + ny * ny + nz * nz")};
            q[0] = nw * shrink; q[1] = nx * shrink; q[2] = ny * shrink; q[3] = nz * shrink;
        }}"""

    @wp.func_native(
        f"""
    {c.declared} {matrix_c(16)} r;
    {number} limit = {number}({accept});
    const V size = {of("a", 0)} + {of("a", 3)} + {of("a", 5)};
    V q[4], size2 = size * size;
    for (int k = 0; k < 9; ++k) size2 += {of("c", "k")} * {of("c", "k")};
    bool settled;
    {evaluation(rest_b)}
    for (int step = 1; step < {NEWTON_STEPS} && !settled; ++step) {{
        if (step + 1 == {NEWTON_STEPS}) limit *= 100;
        {evaluation(turned_b)}
    }}
    return r;"""
    )
    def turn_3d(a: moments.rows, c: squares.rows) -> turns.rows:
        """R - I of eq. 3.9 in space (transposed), the compliance (tr(S) I - S)^-1 of the rotation, and 1 if it settled.

        Newton's steps on a quaternion from the rest orientation (Kugelstadt 2018, 3.2), all lanes together. They end at
        the required maximum exactly when the gradient vanishes and tr(S) I - S is positive definite, so never at a
        reflection. a: rest moments A_qq (upper triangle), c: A_pq - A_qq (transposed)"""

    @wp.func(inline=False)  # rare and long
    def settle(turned: turns.rows, a_qq: moments.rows, change_t: squares.rows):
        """Hands the lanes that did not settle to `functions.turn_3d`, which is global."""
        for l in range(width):
            if turned[15, l] <= zero:
                moment = square()
                change = square()
                moment[0, 0] = a_qq[0, l]
                moment[0, 1] = a_qq[1, l]
                moment[0, 2] = a_qq[2, l]
                moment[1, 0] = a_qq[1, l]
                moment[1, 1] = a_qq[3, l]
                moment[1, 2] = a_qq[4, l]
                moment[2, 0] = a_qq[2, l]
                moment[2, 1] = a_qq[4, l]
                moment[2, 2] = a_qq[5, l]
                for i in range(3):
                    for j in range(3):
                        change[i, j] = change_t[j * 3 + i, l]
                r, c = turn_one(moment, change)
                for i in range(3):
                    for j in range(3):
                        turned[j * 3 + i, l] = r[i, j]
                turned[9, l] = c[0, 0]
                turned[10, l] = c[0, 1]
                turned[11, l] = c[0, 2]
                turned[12, l] = c[1, 1]
                turned[13, l] = c[1, 2]
                turned[14, l] = c[2, 2]
        return turned

    @wp.func
    def turn(a_qq: moments.rows, change_t: squares.rows):
        if wp.static(dim == 2):
            return turn_2d(a_qq, change_t)
        else:  # noqa: RET505 (what follows a static `if` is compiled in any case; a static `else` is not)
            turned = turn_3d(a_qq, change_t)
            if least(turns.row(turned, 15)) > zero:
                return turned
            return settle(turned, a_qq, change_t)

    @wp.func_native(
        f"{c.declared} {matrix_c(square_count)} r; for (int k = 0; k < {square_count}; ++k)"
        f" {of('r', 'k')} = {of('t', 'k')}; return r;"
    )
    def turned_part(t: turns.rows) -> squares.rows: ...

    @wp.func_native(
        f"{c.declared} {matrix_c(compliance_count)} r; for (int k = 0; k < {compliance_count}; ++k)"
        f" {of('r', 'k')} = {of('t', f'k + {square_count}')}; return r;"
    )
    def compliance_part(t: turns.rows) -> compliances.rows: ...

    @wp.func_native(
        f"""
    {matrix_c(4)} r;
    {each} {{
        const {number} skew = c.data[1][l] - c.data[2][l], trace = c.data[0][l] + c.data[3][l];
        const {number} angle = k.data[0][l] * (skew + t.data[0][l] * skew - t.data[1][l] * trace);
        const {number} cosine = angle + t.data[0][l] * angle, sine = t.data[1][l] * angle;
        r.data[0][l] = -sine;
        r.data[1][l] = cosine;
        r.data[2][l] = -cosine;
        r.data[3][l] = -sine;
    }}
    return r;"""
    )
    def turn_change_2d(t: squares.rows, k: compliances.rows, c: squares.rows) -> squares.rows:
        """Change of the rotation R for a change c of A_pq; t is R - I, k the compliance. All are transposed."""

    @wp.func_native(
        f"""
    {matrix_c(9)} r;
    {each} {{
        const {number} r00 = 1 + t.data[0][l], r10 = t.data[1][l], r20 = t.data[2][l];
        const {number} r01 = t.data[3][l], r11 = 1 + t.data[4][l], r21 = t.data[5][l];
        const {number} r02 = t.data[6][l], r12 = t.data[7][l], r22 = 1 + t.data[8][l];
        const {number} c00 = c.data[0][l], c10 = c.data[1][l], c20 = c.data[2][l];
        const {number} c01 = c.data[3][l], c11 = c.data[4][l], c21 = c.data[5][l];
        const {number} c02 = c.data[6][l], c12 = c.data[7][l], c22 = c.data[8][l];
        // axial(R^T dA_pq)
        const {number} g0 = r02 * c01 + r12 * c11 + r22 * c21 - r01 * c02 - r11 * c12 - r21 * c22;
        const {number} g1 = r00 * c02 + r10 * c12 + r20 * c22 - r02 * c00 - r12 * c10 - r22 * c20;
        const {number} g2 = r01 * c00 + r11 * c10 + r21 * c20 - r00 * c01 - r10 * c11 - r20 * c21;
        const {number} w0 = k.data[0][l] * g0 + k.data[1][l] * g1 + k.data[2][l] * g2;
        const {number} w1 = k.data[1][l] * g0 + k.data[3][l] * g1 + k.data[4][l] * g2;
        const {number} w2 = k.data[2][l] * g0 + k.data[4][l] * g1 + k.data[5][l] * g2;
        // dR = R skew(w)
        r.data[0][l] = w2 * r01 - w1 * r02; r.data[1][l] = w2 * r11 - w1 * r12; r.data[2][l] = w2 * r21 - w1 * r22;
        r.data[3][l] = w0 * r02 - w2 * r00; r.data[4][l] = w0 * r12 - w2 * r10; r.data[5][l] = w0 * r22 - w2 * r20;
        r.data[6][l] = w1 * r00 - w0 * r01; r.data[7][l] = w1 * r10 - w0 * r11; r.data[8][l] = w1 * r20 - w0 * r21;
    }}
    return r;"""
    )
    def turn_change_3d(t: squares.rows, k: compliances.rows, c: squares.rows) -> squares.rows:
        """Change of the rotation R for a change c of A_pq; t is R - I, k the compliance. All are transposed."""

    turn_change = turn_change_2d if dim == 2 else turn_change_3d

    @wp.func_native(
        f"{c.declared} {matrix_c(terms * dim)} r; for (int k = 0; k < {terms * dim}; ++k) {of('r', 'k')} ="
        f" {c.at('b.c[0]')} * {of('a', 'k')} + (k < {square_count} ? {c.at('s.c[0]')} * {of('t', 'k')} : (V)0);"
        " return r;"
    )
    def mixed(a: transforms.rows, b: lane, t: squares.rows, s: lane) -> transforms.rows:
        """b a + s [t, 0]."""

    @wp.func(inline=False)  # long, and not needed where theta = 0
    def conserve(
        rest: FitRest,
        cluster: int,
        step: int,
        kept: Kept,
        position: int,
        count: int,
        affine_t: transforms.rows,
        theta: lane,
        volume: int,
    ):
        """A~_theta - [I, 0] of A~ - [I, 0] (transposed): eq. 3.17, or the projection."""
        frame = frames.rows()
        for l in range(width):
            own_cluster = cluster + l * step
            k = rest.span_count[own_cluster]
            th = theta[l]
            a = square()
            for i in range(wp.static(dim)):
                for j in range(wp.static(dim)):
                    a[i, j] = affine_t[j * wp.static(dim) + i, l]
                a[i, i] += one
            if volume == wp.static(PROJECT):
                change, u, v, stretch, mu = project(a * rest.root[own_cluster], k)
                for i in range(wp.static(dim)):
                    for j in range(wp.static(dim)):
                        frame[i * wp.static(dim) + j, l] = u[i, j]
                        frame[wp.static(square_count) + i * wp.static(dim) + j, l] = v[i, j]
                    frame[wp.static(2 * square_count) + i, l] = stretch[i]
                frame[wp.static(2 * square_count + dim), l] = mu
                lifted = change * rest.lift[own_cluster]
                for t in range(wp.static(terms)):
                    for i in range(wp.static(dim)):
                        affine_t[t * wp.static(dim) + i, l] += th * lifted[i, t]
            else:
                denominator = denominator_of(a, th, rest.span_axes[own_cluster], k)
                change = a * (one / denominator - one)
                for i in range(wp.static(dim)):
                    for j in range(wp.static(dim)):
                        affine_t[j * wp.static(dim) + i, l] += change[i, j]
        if kept.stride > 0:
            frames.store(kept.frame, position, kept.stride, frame, count)
        return affine_t

    @wp.func(inline=False)
    def conserve_change(
        rest: FitRest, cluster: int, step: int, kept: Kept, position: int, affine_t: transforms.rows, theta: lane
    ):
        """Derivative of `conserve` by projection for the change `affine_t`, with the frame that it left."""
        frame = frames.load(kept.frame, position, kept.stride)
        for l in range(width):
            own_cluster = cluster + l * step
            k = rest.span_count[own_cluster]
            da = square()
            u = square()
            v = square()
            stretch = vec()
            for i in range(wp.static(dim)):
                for j in range(wp.static(dim)):
                    da[i, j] = affine_t[j * wp.static(dim) + i, l]
                    u[i, j] = frame[i * wp.static(dim) + j, l]
                    v[i, j] = frame[wp.static(square_count) + i * wp.static(dim) + j, l]
                stretch[i] = frame[wp.static(2 * square_count) + i, l]
            mu = frame[wp.static(2 * square_count + dim), l]
            lifted = project_change(u, v, stretch, mu, k, da * rest.root[own_cluster]) * rest.lift[own_cluster]
            for t in range(wp.static(terms)):
                for i in range(wp.static(dim)):
                    affine_t[t * wp.static(dim) + i, l] += theta[l] * lifted[i, t]
        return affine_t

    @wp.func
    def with_null(rest: FitRest, cluster: int, step: int, affine_t: transforms.rows, target: squares.rows):
        """The fit, whose undetermined terms follow their target."""
        if rest.has_null != 0:
            null_t = transforms.own(rest.null_t, cluster, rest.stride, step)
            affine_t = transforms.add(affine_t, one, times_null(null_t, target))
        return affine_t

    @wp.func
    def turned(kept: Kept, position: int, count: int, a_qq: moments.rows, change_t: squares.rows):
        """R - I (eq. 3.9) of rest moments and their change, over the trace of A_qq; stored for `turned_change`."""
        turns = turn(a_qq, change_t)
        t = turned_part(turns)
        if kept.stride > 0:
            squares.store(kept.turned, position, kept.stride, t, count)
            compliances.store(kept.compliance, position, kept.stride, compliance_part(turns), count)
        return t

    @wp.func
    def turned_change(kept: Kept, position: int, change_t: squares.rows):
        """Derivative of `turned` for a change of its moments."""
        t = squares.load(kept.turned, position, kept.stride)
        return turn_change(t, compliances.load(kept.compliance, position, kept.stride), change_t)

    @wp.func
    def blend(
        rest: FitRest,
        cluster: int,
        step: int,
        kept: Kept,
        position: int,
        count: int,
        affine_t: transforms.rows,
        target: squares.rows,
        beta: lane,
        theta: lane,
        volume: int,
    ):
        """The blend of a cluster's rotation and its linear (quadratic) fit (Thesis eq. 3.10 to 3.14, 3.17), less rest.
        affine_t: A~ - [I, 0] (eq. 3.7, 3.14); target: R - I, or that of the rest vectors that it has"""
        affine_t = with_null(rest, cluster, step, affine_t, target)
        if volume != wp.static(NONE):
            affine_t = conserve(rest, cluster, step, kept, position, count, affine_t, theta, volume)
        return mixed(affine_t, beta, target, lane(one) - beta)

    @wp.func
    def blend_change(
        rest: FitRest,
        cluster: int,
        step: int,
        kept: Kept,
        position: int,
        affine_t: transforms.rows,
        change: squares.rows,
        beta: lane,
        theta: lane,
        volume: int,
    ):
        """Derivative of `blend` along a direction whose own fit is `affine_t`; change: change of the target along
        it."""
        affine_t = with_null(rest, cluster, step, affine_t, change)
        if volume != wp.static(NONE):
            affine_t = conserve_change(rest, cluster, step, kept, position, affine_t, theta)
        return mixed(affine_t, beta, change, lane(one) - beta)

    return members(FitRest, Kept, turned, turned_change, with_null, blend, blend_change)
