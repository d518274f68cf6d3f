"""Warp kernels of a body that is one cluster, where a static state has a handful of unknowns; the equations are in
`deformscope.stages.msm.reduced`.

One thread solves one candidate from start to end, in float64. A candidate's input and output are one row of numbers
each, so that a call copies once in and once out."""

import functools
import math
from types import SimpleNamespace

import warp as wp

from deformscope.stages.msm.cluster_functions import PROJECT, SCALE
from deformscope.stages.msm.functions import functions_for
from deformscope.stages.msm.lanes import CPU_FLAGS, Doubles, kernel_in, members

BETA, THETA, TOLERANCE, MOST_ITERATIONS, STARTED, HELD = range(6)
"""Places in a candidate's row: numbers first, then held values, then the transform to start from."""

RESIDUAL, ERROR, ITERATIONS, STATE, TRANSFORM = range(5)
"""Places in a candidate's result: numbers first, then the transform [m] by rows, then the translation [m]."""

NOT_CONVERGED, CONVERGED, DIVERGED = 0, 1, -1

NEWTON_STEPS, TRIALS = 11, 3
"""Largest number of steps at one theta, each tried in full, in half and in quarter."""

ATTEMPTS = 4
"""Times that a state balanced by a rotation which is not the best one is left for another."""

FINEST_PATH = 1.0 / 256.0
"""If Newton's steps fail at theta, theta is approached in parts; a part smaller than this share ends the search."""


@functools.cache
def reduced_functions_for(dim: int, terms: int) -> SimpleNamespace:
    """The functions; arguments as `reduced_kernels_for` has them."""
    scalar = wp.float64
    functions = functions_for(dim, scalar)
    vec, square, turn = functions.vec, functions.square, functions.turn
    volume_denominator, denominator_change = functions.volume_denominator, functions.denominator_change
    project, project_change = functions.project, functions.project_change
    basis_vec = wp.types.vector(length=terms, dtype=scalar)
    transform = wp.types.matrix(shape=(dim, terms), dtype=scalar)
    turns = 1 if dim == 2 else 3
    size = dim * dim + turns
    triple = wp.types.vector(length=3, dtype=scalar)
    system = wp.types.matrix(shape=(size, size), dtype=scalar)
    unknowns = wp.types.vector(length=size, dtype=scalar)
    order = wp.types.vector(length=size, dtype=wp.int32)
    held_q = HELD + terms * dim
    held_centre = held_q + dim * dim
    start_at = held_centre + dim
    row_width = start_at + dim * terms
    translation_at = TRANSFORM + dim * terms
    result_width = translation_at + dim

    zero, one, two, half = scalar(0.0), scalar(1.0), scalar(2.0), scalar(0.5)
    tiny = scalar(1e-13)

    @wp.struct
    class ReducedBody:
        """Rest data, with masses that sum to 1 and lengths in cluster radii.

        mode, free_mode: (terms,) b_j and (G - C) b_j; held_mode: (terms,) first entries of C b_j; share: (terms,) mu_j
        free_q: (dim,) first rows of G - C; null: (dim,) first rows of I - G G+; gram: (terms,) G
        lift, root: how volume is conserved (`volume_frame`); lifted_mode: (terms,) L (G - C) b_j; lift_free:
        L (G - C) J^T; volume: SCALE or PROJECT"""

        mode: wp.array(dtype=basis_vec)
        free_mode: wp.array(dtype=basis_vec)
        held_mode: wp.array(dtype=vec)
        share: Doubles
        free_q: wp.array(dtype=basis_vec)
        null: wp.array(dtype=basis_vec)
        gram: wp.array(dtype=basis_vec)
        lift: wp.array(dtype=basis_vec)
        lifted_mode: wp.array(dtype=vec)
        lift_free: square
        root: square
        volume: int
        held_mean: basis_vec
        a_qq: square
        span_axes: square
        span_count: int
        radius: scalar

    @wp.struct
    class Frame:
        """Contribution of volume conservation to the fit, `gain`, and the values that its derivatives need:
        `volume_frame`."""

        gain: square
        left: square
        right: square
        stretch: vec
        number: scalar

    @wp.struct
    class Sums:
        """N, V, W, U, Y, K: sums over the modes."""

        n: square
        v: square
        w: square
        u: square
        y: square
        k: square

    @wp.func
    def head(values: basis_vec):
        """Its linear terms."""
        out = vec()
        for i in range(wp.static(dim)):
            out[i] = values[i]
        return out

    @wp.func
    def held_moment(row: Doubles, mode: int):
        """y_j: moment of the held particles along one mode."""
        out = vec()
        for i in range(wp.static(dim)):
            out[i] = row[wp.static(HELD) + mode * wp.static(dim) + i]
        return out

    @wp.func
    def axial(m: square):
        """The part of m that turns, as (1,) or (3,) numbers."""
        if wp.static(dim == 2):
            return triple(m[1, 0] - m[0, 1], zero, zero)
        return triple(m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1])

    @wp.func
    def spin(w: triple):
        out = square()
        if wp.static(dim == 2):
            out[0, 1] = -w[0]
            out[1, 0] = w[0]
        else:
            out[2, 1] = w[0]
            out[1, 2] = -w[0]
            out[0, 2] = w[1]
            out[2, 0] = -w[1]
            out[1, 0] = w[2]
            out[0, 1] = -w[2]
        return out

    @wp.func
    def turned_by(r: square, w: triple):
        """R turned on by w, a rotation to the last digit (Cayley's formula)."""
        s = spin(w * half)
        return r + r * (s + s * s) * (two / (one + wp.dot(w, w) * half * half))

    @wp.func
    def identity():
        return wp.identity(n=dim, dtype=scalar)

    @wp.func
    def volume_frame(body: ReducedBody, a: square, theta: scalar):
        """Contribution of volume conservation to the fit, as multiples of `lift`, and the values that `volume_change`
        needs.

        Eq. 3.17: A / den - A. Projection: theta (P - B), with B = A root and P the nearest matrix of the rest volume.
        """
        frame = Frame()
        if body.volume == wp.static(PROJECT):
            toward, left, right, stretch, mu = project(a * body.root, body.span_count)
            frame.gain = toward * theta
            frame.left = left
            frame.right = right
            frame.stretch = stretch
            frame.number = mu
        else:
            den = volume_denominator(a, theta, body.span_axes, body.span_count)
            frame.gain = a * ((one - den) / den)
            frame.number = den
        return frame

    @wp.func
    def volume_change(body: ReducedBody, a: square, theta: scalar, frame: Frame, change: square):
        """Derivative of `volume_frame`'s gain for dA = change."""
        if body.volume == wp.static(PROJECT):
            moved = change * body.root
            return project_change(frame.left, frame.right, frame.stretch, frame.number, body.span_count, moved) * theta
        den = frame.number
        d_den = denominator_change(a, change, theta, body.span_axes, body.span_count)
        return change * ((one - den) / den) - a * (d_den / (den * den))

    @wp.func
    def sums(body: ReducedBody, row: Doubles, beta: scalar):
        """The sums at beta."""
        m = Sums()
        m.u = identity()
        for i in range(wp.static(dim)):
            for j in range(wp.static(dim)):
                m.w[i, j] = body.free_q[i][j]
                m.k[i, j] = row[wp.static(held_q) + i * wp.static(dim) + j]
        m.v = body.lift_free
        for j in range(wp.static(terms)):
            first = gain(body, beta, j)
            second = beta * first
            a = head(body.free_mode[j])
            above = body.lifted_mode[j]
            b = head(body.mode[j])
            c = body.held_mode[j]
            p = held_moment(row, j)
            m.n += wp.outer(above, b) * first
            m.u -= wp.outer(c, b) * first
            m.y += wp.outer(p, b) * first
            m.v += wp.outer(above, a) * second
            m.w -= wp.outer(c, a) * second
            m.k += wp.outer(p, a) * second
        return m

    @wp.func
    def gain(body: ReducedBody, beta: scalar, mode: int):
        """1 / (1 - beta lambda_j); 0 for modes that nothing holds in shape (beta = 1): they stay as at rest."""
        left = (one - beta) + beta * body.share[mode]
        if left <= tiny:
            return zero
        return one / left

    @wp.func
    def lifted(body: ReducedBody, e: square):
        """e L."""
        out = transform()
        for i in range(wp.static(dim)):
            for j in range(wp.static(dim)):
                for m in range(wp.static(terms)):
                    out[i, m] = out[i, m] + e[i, j] * body.lift[j][m]
        return out

    @wp.func
    def assemble(body: ReducedBody, row: Doubles, beta: scalar, e: square, r: square):
        """T = e L + R J + sum_j beta g_j (e L (G - C) b_j + y_j - R J C b_j) b_j^T."""
        out = transform()
        for i in range(wp.static(dim)):
            for j in range(wp.static(dim)):
                out[i, j] = r[i, j]
        out += lifted(body, e)
        for j in range(wp.static(terms)):
            p = e * body.lifted_mode[j] + held_moment(row, j) - r * body.held_mode[j]
            out += wp.outer(p * (beta * gain(body, beta, j)), body.mode[j])
        return out

    @wp.func
    def fit(body: ReducedBody, row: Doubles, t: transform):
        """R of the rotation and A~ of the fit (eq. 3.7, 3.9, 3.14) for the state T, held particles included."""
        a_pq = square()
        for i in range(wp.static(dim)):
            for j in range(wp.static(dim)):
                total = row[wp.static(held_q) + i * wp.static(dim) + j]
                for m in range(wp.static(terms)):
                    total += t[i, m] * body.free_q[j][m]
                a_pq[i, j] = total
        turned, _compliance = turn(body.a_qq, a_pq - body.a_qq)
        r = turned + identity()
        out = transform()
        for j in range(wp.static(terms)):
            out += wp.outer(t * body.free_mode[j] + held_moment(row, j), body.mode[j])
        for i in range(wp.static(dim)):
            for j in range(wp.static(dim)):
                for m in range(wp.static(terms)):
                    out[i, m] = out[i, m] + r[i, j] * body.null[j][m]
        return r, out

    @wp.func
    def linear_part(t: transform):
        out = square()
        for i in range(wp.static(dim)):
            for j in range(wp.static(dim)):
                out[i, j] = t[i, j]
        return out

    @wp.func
    def misfit(body: ReducedBody, row: Doubles, t: transform, beta: scalar, theta: scalar):
        """Root mean square of goal - place over all particles of the state T (none treated as held), from separately
        evaluated equations. And their rotation and linear fit."""
        r, a = fit(body, row, t)
        linear = linear_part(a)
        frame = volume_frame(body, linear, theta)
        e = frame.gain
        off = a * beta - t + lifted(body, e * beta)
        for i in range(wp.static(dim)):
            for j in range(wp.static(dim)):
                off[i, j] = off[i, j] + (one - beta) * r[i, j]
        total = zero
        for i in range(wp.static(dim)):
            for j in range(wp.static(terms)):
                for m in range(wp.static(terms)):
                    total += off[i, j] * off[i, m] * body.gram[j][m]
        return wp.sqrt(wp.max(total, zero)), r, linear

    @wp.func
    def pack(f: square, g: triple):
        out = unknowns()
        for i in range(wp.static(dim)):
            for j in range(wp.static(dim)):
                out[i * wp.static(dim) + j] = f[i, j]
        for i in range(wp.static(turns)):
            out[wp.static(dim * dim) + i] = g[i]
        return out

    @wp.func
    def unpack(x: unknowns):
        f = square()
        g = triple()
        for i in range(wp.static(dim)):
            for j in range(wp.static(dim)):
                f[i, j] = x[i * wp.static(dim) + j]
        for i in range(wp.static(turns)):
            g[i] = x[wp.static(dim * dim) + i]
        return f, g

    @wp.func
    def defect(a: square, r: square, e: square, m: Sums):
        """The residual: Y + R U + e N - A, and the turning part of R^T (K + e V) + W."""
        return pack(m.y + r * m.u + e * m.n - a, axial(wp.transpose(r) * (m.k + e * m.v) + m.w))

    @wp.func
    def weight_of(k: square):
        """With it the equations of the rotation weigh as much as the others; 1 where nothing turns the body."""
        size = wp.sqrt(wp.ddot(k, k))
        if size > tiny:
            return one / size
        return one

    @wp.func
    def weighed(f: unknowns, weight: scalar):
        """Length of a defect, with its equations of the rotation weighed like the others."""
        out = f
        for i in range(wp.static(dim * dim), wp.static(size)):
            out[i] = f[i] * weight
        return wp.length(out)

    @wp.func
    def solve(
        body: ReducedBody,
        a: square,
        r: square,
        beta: scalar,
        theta: scalar,
        frame: Frame,
        modes: Sums,
        weight: scalar,
        value: unknowns,
    ):
        """x of (- d defect) x = value, by elimination with full pivots, at a state and its `volume_frame`.

        Unknowns that nothing determines (a rotation that the held particles leave free) stay 0."""
        pull = wp.transpose(r) * (modes.k + frame.gain * modes.v * beta)
        m = system()
        b = value
        place = order()
        for column in range(wp.static(size)):
            place[column] = column
            x = unknowns()
            x[column] = one
            da, dw = unpack(x)
            de = volume_change(body, a, theta, frame, da) * beta
            s = spin(dw)
            change = pack(r * s * modes.u + de * modes.n - da, axial(wp.transpose(r) * de * modes.v - s * pull))
            for i in range(wp.static(size)):
                m[i, column] = -change[i]
        for i in range(wp.static(dim * dim), wp.static(size)):
            b[i] = b[i] * weight
            for j in range(wp.static(size)):
                m[i, j] = m[i, j] * weight
        rank = int(0)
        first = zero
        for pivot in range(wp.static(size)):
            row = int(pivot)
            column = int(pivot)
            best = zero
            for i in range(pivot, wp.static(size)):
                for j in range(pivot, wp.static(size)):
                    if wp.abs(m[i, j]) > best:
                        best = wp.abs(m[i, j])
                        row = i
                        column = j
            if pivot == 0:
                first = best
            if not best > tiny * first:
                break
            rank = pivot + 1
            for j in range(wp.static(size)):
                swap = m[pivot, j]
                m[pivot, j] = m[row, j]
                m[row, j] = swap
            for i in range(wp.static(size)):
                swap = m[i, pivot]
                m[i, pivot] = m[i, column]
                m[i, column] = swap
            swap = b[pivot]
            b[pivot] = b[row]
            b[row] = swap
            swap_place = place[pivot]
            place[pivot] = place[column]
            place[column] = swap_place
            for i in range(pivot + 1, wp.static(size)):
                ratio = m[i, pivot] / m[pivot, pivot]
                for j in range(pivot + 1, wp.static(size)):
                    m[i, j] = m[i, j] - ratio * m[pivot, j]
                b[i] = b[i] - ratio * b[pivot]
        out = unknowns()
        for back in range(rank):
            i = rank - 1 - back
            total = b[i]
            for j in range(i + 1, rank):
                total -= m[i, j] * out[place[j]]
            out[place[i]] = total / m[i, i]
        return out

    @wp.func
    def stable(n: square, excess: scalar):
        """Whether the goals pull the shape back while the denominator of eq. 3.17 is unchanged, for excess =
        beta (1 / denominator - 1): every eigenvalue of I - excess N above 0. Beyond, time stepping leaves the state."""
        m = identity() - n * excess
        good = wp.determinant(m) > zero and wp.trace(m) > zero
        if wp.static(dim == 3):
            minors = zero
            for i in range(wp.static(dim)):
                for j in range(wp.static(dim)):
                    if j > i:
                        minors += m[i, i] * m[j, j] - m[i, j] * m[j, i]
            good = good and minors > zero
        return good

    made = members(
        *(ReducedBody, Frame, turned_by, identity, volume_frame, volume_change, sums, assemble, fit, linear_part),
        *(misfit, pack, unpack, defect, weight_of, weighed, solve, stable, spin, axial),
    )
    made.vec, made.square, made.triple, made.unknowns, made.turn = vec, square, triple, unknowns, turn
    made.basis_vec, made.transform, made.start_at, made.held_centre = basis_vec, transform, start_at, held_centre
    made.translation_at, made.row_width, made.result_width = translation_at, row_width, result_width
    return made


@functools.cache
def reduced_kernels_for(dim: int, terms: int) -> SimpleNamespace:
    """The kernels for `dim` = 2 or 3 and `terms` = 2, 3 (linear) or 5, 9 (quadratic)."""
    name, scalar = f"msm_reduced_{dim}d_{terms}", wp.float64
    # flags as those of the lanes: compiled with others, warp's own headers would be taken through once more
    options = {"enable_backward": False, "max_unroll": 1, "cpu_compiler_flags": CPU_FLAGS}
    relaxing = kernel_in(name, scalar, options)
    of = reduced_functions_for(dim, terms)
    ReducedBody, Frame, transform, square = of.ReducedBody, of.Frame, of.transform, of.square
    start_at, translation_at, held_centre = of.start_at, of.translation_at, of.held_centre
    zero, one, two, half = scalar(0.0), scalar(1.0), scalar(2.0), scalar(0.5)
    tiny, near, finest = scalar(1e-13), scalar(1e-8), scalar(FINEST_PATH)
    far, infinite = scalar(1e6), scalar(math.inf)

    @relaxing
    def relax(body: ReducedBody, rows: wp.array2d(dtype=scalar), results: wp.array2d(dtype=scalar)):
        """The static state of one candidate: Newton's steps on its few unknowns, from theta = 0, where the state is
        known, or from a given start. Where they fail they go to theta in parts."""
        candidate = wp.tid()
        row = rows[candidate]
        beta = row[wp.static(BETA)]
        theta = row[wp.static(THETA)]
        tolerance = row[wp.static(TOLERANCE)]
        most = int(row[wp.static(MOST_ITERATIONS)])
        modes = of.sums(body, row, beta)
        # theta = 0: R maximises tr(R^T K); what K leaves free stays as at the start
        r_start = of.identity()
        a_start = square()
        t = transform()
        if row[wp.static(STARTED)] != zero:
            for i in range(wp.static(dim)):
                for j in range(wp.static(terms)):
                    t[i, j] = row[wp.static(start_at) + i * wp.static(terms) + j]
            r_start, fitted = of.fit(body, row, t)
            a_start = of.linear_part(fitted)
        r_free = r_start
        pull = wp.sqrt(wp.ddot(modes.k, modes.k))
        if pull > tiny:
            turned, _compliance = of.turn(square(), wp.transpose(r_start) * modes.k / pull + of.identity() * near)
            r_free = r_start * (turned + of.identity())
        a_free = modes.y + r_free * modes.u

        weight = of.weight_of(modes.k)
        iterations = int(0)
        found = bool(False)
        error = infinite
        a = a_free
        r = r_free
        good_a = a_free
        good_r = r_free
        good_gain = square()
        reached = zero
        target = theta
        own_start = row[wp.static(STARTED)] != zero
        if own_start:
            a = a_start
        residual = infinite
        for _attempt in range(wp.static(ATTEMPTS)):
            while iterations < most:
                f = of.unknowns()
                frame = Frame()
                da = square()
                dw = of.triple()
                before = infinite
                last = bool(False)
                settled = bool(False)
                for _newton in range(wp.static(NEWTON_STEPS)):
                    shorter = one
                    lower = bool(False)
                    for _halving in range(wp.static(TRIALS)):
                        a_new = a + da * shorter
                        r_new = of.turned_by(r, dw * shorter)
                        frame = of.volume_frame(body, a_new, target)
                        f = of.defect(a_new, r_new, frame.gain * beta, modes)
                        length = of.weighed(f, weight)
                        if length < before or last:
                            a = a_new
                            r = r_new
                            before = length
                            lower = bool(True)
                            break
                        shorter = shorter * half
                    if last:
                        settled = bool(True)
                    if last or not lower or iterations >= most:
                        break
                    step = of.solve(body, a, r, beta, target, frame, modes, weight, f)
                    da, dw = of.unpack(step)
                    error = wp.length(step)
                    iterations += 1
                    last = error <= tolerance
                    if not error < far:
                        break
                if settled and body.volume == wp.static(SCALE):
                    settled = of.stable(modes.n, beta * (one - frame.number) / frame.number)
                if settled:
                    good_a = a
                    good_r = r
                    good_gain = frame.gain
                    if target == theta:
                        found = bool(True)
                        break
                    ahead = two * (target - reached)
                    reached = target
                    target = wp.min(theta, target + ahead)
                else:
                    if not own_start:
                        target = half * (reached + target)
                        if target - reached <= finest * theta:
                            break
                    own_start = bool(False)
                    a = good_a
                    r = good_r
            t = of.assemble(body, row, beta, good_gain * beta, good_r)
            residual, r, a = of.misfit(body, row, t, beta, theta)
            if not found or residual <= tolerance:
                break
            # balanced, but another rotation fits better: on from that one
            own_start = bool(True)
            found = bool(False)
            good_a = a_free
            good_r = r_free
            reached = zero
            target = theta
        if not found:
            error = infinite
        state = int(NOT_CONVERGED)
        if found:
            if residual <= tolerance:
                state = int(CONVERGED)
        elif iterations < most and body.volume == wp.static(SCALE):
            state = int(DIVERGED)
        result = results[candidate]
        result[wp.static(RESIDUAL)] = residual * body.radius
        result[wp.static(ERROR)] = error * body.radius
        result[wp.static(ITERATIONS)] = scalar(iterations)
        result[wp.static(STATE)] = scalar(state)
        for i in range(wp.static(dim)):
            place = row[wp.static(held_centre) + i]
            for j in range(wp.static(terms)):
                metres = t[i, j] * body.radius
                result[wp.static(TRANSFORM) + i * wp.static(terms) + j] = metres
                place -= metres * body.held_mean[j]
            result[wp.static(translation_at) + i] = place

    made = members(ReducedBody, relax, square=square)
    made.vec, made.basis_vec, made.row_width, made.result_width = of.vec, of.basis_vec, of.row_width, of.result_width
    return made
