"""Warp kernels of the MSM engine, one set for each space dimension, basis and precision.

State is the displacement u from rest in units of the particle spacing, so that float32 keeps its digits and SI units
do not matter. Candidates (beta, theta, poses) are the slow axis of every array. All sums gather in a fixed order:
runs repeat bit for bit. A candidate that is not `RUNNING` is left as it is.

Annotations here are read by warp while the closures are made, so they are not postponed (no `__future__` import).
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from deformscope.stages.msm.functions import functions_for

MEMORY = 8
"""Earlier iterates that Anderson's acceleration combines."""

CHUNK = 128
"""Particles that one thread sums in an inner product; the partial sums are then added in order."""

RUNNING, CONVERGED, DIVERGED = 1, 0, -1


@dataclass(frozen=True, slots=True)
class Kernels:
    """The compiled set, and its vector and matrix types."""

    scalar: Any
    vec: Any
    basis_vec: Any
    transform: Any
    moment: Any
    predict: Any
    fit_clusters: Any
    goals: Any
    integrate: Any
    remember: Any
    products: Any
    accelerate: Any
    advance: Any
    fit_changes: Any
    residual_products: Any
    conjugate: Any
    direct: Any
    curvature_products: Any
    choose_step: Any
    take_step: Any
    history: Any
    history_vec: Any


@functools.cache
def kernels_for(dim: int, terms: int, scalar: Any) -> Kernels:
    """The kernels for `dim` = 2 or 3, `terms` = 2, 3 (linear) or 5, 9 (quadratic), scalar = wp.float32 or wp.float64.

    Compiled at first use, cached on disk by warp.
    """
    module = f"deformscope_msm_{dim}d_{terms}_{scalar.__name__}"
    wp.get_module(module).options.update({"enable_backward": False, "max_unroll": 3})
    kernel = functools.partial(wp.kernel, module=module, enable_backward=False)
    functions = functions_for(dim, scalar)
    vec, square, turn, turn_change = functions.vec, functions.square, functions.turn, functions.turn_change
    basis_vec = wp.types.vector(length=terms, dtype=scalar)
    volume_denominator = functions.volume_denominator
    transform = wp.types.matrix(shape=(dim, terms), dtype=scalar)
    history = wp.types.matrix(shape=(MEMORY, MEMORY), dtype=wp.float64)
    history_vec = wp.types.vector(length=MEMORY, dtype=wp.float64)

    zero, one = scalar(0.0), scalar(1.0)
    far = wp.float64(1e4)
    growth = wp.float64(1e2)
    flat = wp.float64(1e-12 if scalar is wp.float64 else 1e-7)
    floor = wp.float64(1e-14 if scalar is wp.float64 else 1e-8)
    ridge = wp.float64(1e-14 if scalar is wp.float64 else 1e-8)

    @wp.func
    def fit_affine(
        candidate: int,
        first: int,
        last: int,
        members: wp.array(dtype=int),
        share: wp.array(dtype=scalar),
        weight: wp.array(dtype=basis_vec),
        moment: wp.array(dtype=vec),
        u: wp.array2d(dtype=vec),
    ):
        """A cluster's mean displacement, its linear (or quadratic) fit A~ - [I, 0] (eq. 3.7, 3.14), and A_pq - A_qq."""
        centre = vec()
        for slot in range(first, last):
            centre += share[slot] * u[candidate, members[slot]]
        g = transform()
        a_pq = square()
        for slot in range(first, last):
            away = u[candidate, members[slot]] - centre
            g += wp.outer(away, weight[slot])
            a_pq += wp.outer(away, moment[slot])
        return centre, g, a_pq

    @kernel
    def predict(
        # In:
        u_in: wp.array2d(dtype=vec),
        v_in: wp.array2d(dtype=vec),
        held_row: wp.array(dtype=int),
        held_u: wp.array2d(dtype=vec),
        acceleration: vec,
        dt: scalar,
        # Out:
        u_out: wp.array2d(dtype=vec),
    ):
        """x* of eq. 3.1, 3.2; held particles stand where they are put."""
        candidate, particle = wp.tid()
        row = held_row[particle]
        if row >= 0:
            u_out[candidate, particle] = held_u[candidate, row]
        else:
            v_star = v_in[candidate, particle] + acceleration * dt
            u_out[candidate, particle] = u_in[candidate, particle] + v_star * dt

    @kernel
    def fit_clusters(
        # Rest:
        offsets: wp.array(dtype=int),
        members: wp.array(dtype=int),
        share: wp.array(dtype=scalar),
        weight: wp.array(dtype=basis_vec),
        moment: wp.array(dtype=vec),
        a_qq: wp.array(dtype=square),
        span_axes: wp.array(dtype=square),
        span_count: wp.array(dtype=int),
        untold: wp.array(dtype=transform),
        # In:
        u_in: wp.array2d(dtype=vec),
        beta: wp.array(dtype=scalar),
        theta: wp.array(dtype=scalar),
        running: wp.array(dtype=int),
        # Out:
        transform_out: wp.array2d(dtype=transform),
        centre_out: wp.array2d(dtype=vec),
        turned_out: wp.array2d(dtype=square),
        compliance_out: wp.array2d(dtype=square),
    ):
        """Each cluster's blend (1 - beta) [R - I, 0] + beta (A~_theta - [I, 0]) and its mean displacement.

        Thesis eq. 3.7 to 3.14 and 3.17.
        """
        candidate, cluster = wp.tid()
        if running[candidate] != wp.static(RUNNING):
            return
        centre, g, a_pq = fit_affine(
            candidate, offsets[cluster], offsets[cluster + 1], members, share, weight, moment, u_in
        )
        r, compliance = turn(a_qq[cluster], a_pq)
        g += r * untold[cluster]  # terms that the cluster cannot tell follow its rotation
        b = beta[candidate]
        th = theta[candidate]
        excess = zero
        denominator = one
        if th != zero:
            a = square()
            for i in range(wp.static(dim)):
                for j in range(wp.static(dim)):
                    a[i, j] = g[i, j]
                a[i, i] += one
            denominator = volume_denominator(a, th, span_axes[cluster], span_count[cluster])
            excess = one - denominator
        blend = b * g
        for i in range(wp.static(dim)):
            for j in range(wp.static(dim)):
                stretched = g[i, j]
                if i == j:
                    stretched += excess
                blend[i, j] = b * stretched / denominator + (one - b) * r[i, j]
        transform_out[candidate, cluster] = blend
        centre_out[candidate, cluster] = centre
        turned_out[candidate, cluster] = r
        compliance_out[candidate, cluster] = compliance

    @kernel
    def fit_changes(
        # Rest:
        offsets: wp.array(dtype=int),
        members: wp.array(dtype=int),
        share: wp.array(dtype=scalar),
        weight: wp.array(dtype=basis_vec),
        moment: wp.array(dtype=vec),
        untold: wp.array(dtype=transform),
        # In:
        direction_in: wp.array2d(dtype=vec),
        turned_in: wp.array2d(dtype=square),
        compliance_in: wp.array2d(dtype=square),
        beta: wp.array(dtype=scalar),
        running: wp.array(dtype=int),
        # Out:
        transform_out: wp.array2d(dtype=transform),
        centre_out: wp.array2d(dtype=vec),
    ):
        """Derivative of `fit_clusters` along a direction, for theta = 0."""
        candidate, cluster = wp.tid()
        if running[candidate] != wp.static(RUNNING):
            return
        centre, g, a_pq = fit_affine(
            candidate, offsets[cluster], offsets[cluster + 1], members, share, weight, moment, direction_in
        )
        r = turn_change(turned_in[candidate, cluster], compliance_in[candidate, cluster], a_pq)
        g += r * untold[cluster]
        b = beta[candidate]
        blend = b * g
        for i in range(wp.static(dim)):
            for j in range(wp.static(dim)):
                blend[i, j] = blend[i, j] + (one - b) * r[i, j]
        transform_out[candidate, cluster] = blend
        centre_out[candidate, cluster] = centre

    @kernel
    def goals(
        # Rest:
        row_offsets: wp.array(dtype=int),
        row_clusters: wp.array(dtype=int),
        row_basis: wp.array(dtype=basis_vec),
        held_row: wp.array(dtype=int),
        # In:
        u_in: wp.array2d(dtype=vec),
        transform_in: wp.array2d(dtype=transform),
        centre_in: wp.array2d(dtype=vec),
        running: wp.array(dtype=int),
        # Out:
        residual_out: wp.array2d(dtype=vec),
    ):
        """Mean goal of a particle over its clusters (eq. 3.15), less where it is: g - x*; 0 if held."""
        candidate, particle = wp.tid()
        if running[candidate] != wp.static(RUNNING):
            return
        residual = vec()
        if held_row[particle] < 0:
            first = row_offsets[particle]
            last = row_offsets[particle + 1]
            u = u_in[candidate, particle]
            for slot in range(first, last):
                cluster = row_clusters[slot]
                residual += (centre_in[candidate, cluster] - u) + transform_in[candidate, cluster] * row_basis[slot]
            residual = residual / scalar(last - first)
        residual_out[candidate, particle] = residual

    @kernel
    def integrate(
        # In:
        u_old: wp.array2d(dtype=vec),
        u_star: wp.array2d(dtype=vec),
        residual_in: wp.array2d(dtype=vec),
        alpha: scalar,
        dt: scalar,
        # Out:
        u_out: wp.array2d(dtype=vec),
        v_out: wp.array2d(dtype=vec),
        diverged_out: wp.array(dtype=int),
    ):
        """Eq. 3.11 and 3.12. `u_out` may be `u_old`. A particle that would run away stays, and marks its candidate."""
        candidate, particle = wp.tid()
        before = u_old[candidate, particle]
        after = u_star[candidate, particle] + alpha * residual_in[candidate, particle]
        if wp.dot(after, after) < scalar(far) * scalar(far):
            u_out[candidate, particle] = after
            v_out[candidate, particle] = (after - before) / dt
        else:
            v_out[candidate, particle] = vec()
            diverged_out[candidate] = 1

    @kernel
    def remember(
        # In:
        u_in: wp.array2d(dtype=vec),
        residual_in: wp.array2d(dtype=vec),
        iteration: wp.array(dtype=int),
        running: wp.array(dtype=int),
        # Out:
        u_last_out: wp.array2d(dtype=vec),
        residual_last_out: wp.array2d(dtype=vec),
        du_out: wp.array3d(dtype=vec),
        dr_out: wp.array3d(dtype=vec),
    ):
        """Keep the change of iterate and of residual since the last iteration in this iteration's slot."""
        candidate, particle = wp.tid()
        if running[candidate] != wp.static(RUNNING):
            return
        u = u_in[candidate, particle]
        r = residual_in[candidate, particle]
        k = iteration[candidate]
        if k > 0:
            slot = (k - 1) % wp.static(MEMORY)
            du_out[candidate, slot, particle] = u - u_last_out[candidate, particle]
            dr_out[candidate, slot, particle] = r - residual_last_out[candidate, particle]
        u_last_out[candidate, particle] = u
        residual_last_out[candidate, particle] = r

    @kernel
    def products(
        # Rest:
        metric: wp.array(dtype=scalar),
        # In:
        residual_in: wp.array2d(dtype=vec),
        du_in: wp.array3d(dtype=vec),
        dr_in: wp.array3d(dtype=vec),
        iteration: wp.array(dtype=int),
        running: wp.array(dtype=int),
        particle_count: int,
        # Out: (candidate, what, chunk); what = slots then the residual itself
        gram_out: wp.array3d(dtype=wp.float64),
        rhs_out: wp.array3d(dtype=wp.float64),
        step_out: wp.array2d(dtype=wp.float64),
    ):
        """Partial inner products in the metric that makes the goal map symmetric (weights N_i).

        gram: newest residual change with each one; rhs: each with the residual; step: squared length of the last step.
        """
        candidate, what, chunk = wp.tid()
        if running[candidate] != wp.static(RUNNING):
            return
        k = iteration[candidate]
        first = chunk * wp.static(CHUNK)
        last = wp.min(first + wp.static(CHUNK), particle_count)
        newest = wp.max(k - 1, 0) % wp.static(MEMORY)
        with_newest = wp.float64(0.0)
        with_residual = wp.float64(0.0)
        if what == wp.static(MEMORY):
            step = wp.float64(0.0)
            for i in range(first, last):
                r = residual_in[candidate, i]
                d = du_in[candidate, newest, i]
                with_residual += wp.float64(metric[i] * wp.dot(r, r))
                step += wp.float64(metric[i] * wp.dot(d, d))
            step_out[candidate, chunk] = step
        elif what < k:
            for i in range(first, last):
                d = dr_in[candidate, what, i]
                with_newest += wp.float64(metric[i] * wp.dot(d, dr_in[candidate, newest, i]))
                with_residual += wp.float64(metric[i] * wp.dot(d, residual_in[candidate, i]))
        gram_out[candidate, what, chunk] = with_newest
        rhs_out[candidate, what, chunk] = with_residual

    @kernel
    def accelerate(
        # In:
        gram_part: wp.array3d(dtype=wp.float64),
        rhs_part: wp.array3d(dtype=wp.float64),
        step_part: wp.array2d(dtype=wp.float64),
        chunk_count: int,
        metric_total: wp.float64,
        tolerance: wp.float64,
        # In and out:
        gram_state: wp.array(dtype=history),
        path: wp.array(dtype=wp.float64),
        mark: wp.array(dtype=int),
        iteration: wp.array(dtype=int),
        best: wp.array(dtype=wp.float64),
        running: wp.array(dtype=int),
        # Out:
        gamma_out: wp.array(dtype=history_vec),
        residual_out: wp.array(dtype=wp.float64),
        error_out: wp.array(dtype=wp.float64),
        total_out: wp.array(dtype=int),
    ):
        """Anderson's weights of the remembered changes: least squares of the residual over them, slightly damped.

        The distance still to go is judged by the path over the last quarter of all iterations, not by the residual: a
        mode that decays by 0.9998 a step has a residual 5000 times smaller than its error, but accelerated steps
        are as long as the error that they remove. When the residual has grown far above its best, the memory is
        dropped and a plain step follows.
        """
        candidate = wp.tid()
        if running[candidate] != wp.static(RUNNING):
            return
        k = iteration[candidate]
        square_norm = wp.float64(0.0)
        for chunk in range(chunk_count):
            square_norm += rhs_part[candidate, wp.static(MEMORY), chunk]
        norm = wp.sqrt(square_norm / metric_total)
        residual_out[candidate] = norm
        total_out[candidate] = total_out[candidate] + 1
        if not wp.isfinite(norm) or norm > far:
            running[candidate] = wp.static(DIVERGED)
            return
        if norm <= floor:
            running[candidate] = wp.static(CONVERGED)
            return
        if k > 0:
            square_step = wp.float64(0.0)
            for chunk in range(chunk_count):
                square_step += step_part[candidate, chunk]
            path[candidate] = path[candidate] + wp.sqrt(square_step / metric_total)
        done = total_out[candidate]
        if done >= mark[candidate]:
            error_out[candidate] = path[candidate]
            mark[candidate] = done + wp.max(done / 3, 8)
            path[candidate] = wp.float64(0.0)
            if error_out[candidate] <= tolerance:
                running[candidate] = wp.static(CONVERGED)
                return
        gamma = history_vec()
        if norm > growth * best[candidate]:
            iteration[candidate] = 0
            gamma_out[candidate] = gamma
            best[candidate] = norm
            return
        best[candidate] = wp.min(best[candidate], norm)
        g = gram_state[candidate]
        size = wp.min(k, wp.static(MEMORY))
        rhs = history_vec()
        if k > 0:
            newest = (k - 1) % wp.static(MEMORY)
            for i in range(size):
                both = wp.float64(0.0)
                with_residual = wp.float64(0.0)
                for chunk in range(chunk_count):
                    both += gram_part[candidate, i, chunk]
                    with_residual += rhs_part[candidate, i, chunk]
                g[i, newest] = both
                g[newest, i] = both
                rhs[i] = with_residual
        gram_state[candidate] = g
        # scaled to a unit diagonal (the changes shrink by orders as it converges), then Cholesky with a small ridge
        scale = history_vec()
        for i in range(size):
            scale[i] = wp.float64(0.0)
            if g[i, i] > wp.float64(0.0):
                scale[i] = wp.float64(1.0) / wp.sqrt(g[i, i])
        low = history()
        for i in range(size):
            for j in range(i + 1):
                total = g[i, j] * scale[i] * scale[j]
                if i == j:
                    total = wp.float64(1.0) + ridge
                for m in range(j):
                    total -= low[i, m] * low[j, m]
                if i == j:
                    low[i, i] = wp.sqrt(wp.max(total, ridge))
                else:
                    low[i, j] = total / low[j, j]
        y = history_vec()
        for i in range(size):
            total = rhs[i] * scale[i]
            for m in range(i):
                total -= low[i, m] * y[m]
            y[i] = total / low[i, i]
        for back in range(size):
            i = size - 1 - back
            total = y[i]
            for m in range(i + 1, size):
                total -= low[m, i] * gamma[m]
            gamma[i] = total / low[i, i]
        for i in range(size):
            gamma[i] = gamma[i] * scale[i]
        gamma_out[candidate] = gamma
        iteration[candidate] = k + 1

    @kernel
    def advance(
        # In:
        residual_in: wp.array2d(dtype=vec),
        du_in: wp.array3d(dtype=vec),
        dr_in: wp.array3d(dtype=vec),
        gamma: wp.array(dtype=history_vec),
        iteration: wp.array(dtype=int),
        held_row: wp.array(dtype=int),
        running: wp.array(dtype=int),
        # Out:
        u_out: wp.array2d(dtype=vec),
    ):
        """The accelerated step."""
        candidate, particle = wp.tid()
        if running[candidate] != wp.static(RUNNING) or held_row[particle] >= 0:
            return
        move = residual_in[candidate, particle]
        size = wp.min(iteration[candidate] - 1, wp.static(MEMORY))
        for i in range(size):
            w = scalar(gamma[candidate][i])
            move -= w * (du_in[candidate, i, particle] + dr_in[candidate, i, particle])
        u_out[candidate, particle] = u_out[candidate, particle] + move

    @kernel
    def residual_products(
        # Rest:
        metric: wp.array(dtype=scalar),
        # In:
        residual_in: wp.array2d(dtype=vec),
        residual_last: wp.array2d(dtype=vec),
        running: wp.array(dtype=int),
        particle_count: int,
        # Out:
        own_out: wp.array2d(dtype=wp.float64),
        cross_out: wp.array2d(dtype=wp.float64),
    ):
        """Partial sums of |r|^2 and of r with the residual before it."""
        candidate, chunk = wp.tid()
        if running[candidate] != wp.static(RUNNING):
            return
        first = chunk * wp.static(CHUNK)
        own = wp.float64(0.0)
        cross = wp.float64(0.0)
        for i in range(first, wp.min(first + wp.static(CHUNK), particle_count)):
            r = residual_in[candidate, i]
            own += wp.float64(metric[i] * wp.dot(r, r))
            cross += wp.float64(metric[i] * wp.dot(r, residual_last[candidate, i]))
        own_out[candidate, chunk] = own
        cross_out[candidate, chunk] = cross

    @kernel
    def conjugate(
        # In:
        own_part: wp.array2d(dtype=wp.float64),
        cross_part: wp.array2d(dtype=wp.float64),
        chunk_count: int,
        metric_total: wp.float64,
        # In and out:
        own_last: wp.array(dtype=wp.float64),
        fresh: wp.array(dtype=int),
        running: wp.array(dtype=int),
        # Out:
        mix_out: wp.array(dtype=scalar),
        residual_out: wp.array(dtype=wp.float64),
        total_out: wp.array(dtype=int),
    ):
        """How much of the last direction to keep (Polak-Ribiere, never negative); 0 after a restart."""
        candidate = wp.tid()
        if running[candidate] != wp.static(RUNNING):
            return
        own = wp.float64(0.0)
        cross = wp.float64(0.0)
        for chunk in range(chunk_count):
            own += own_part[candidate, chunk]
            cross += cross_part[candidate, chunk]
        norm = wp.sqrt(own / metric_total)
        residual_out[candidate] = norm
        total_out[candidate] = total_out[candidate] + 1
        if not wp.isfinite(norm) or norm > far:
            running[candidate] = wp.static(DIVERGED)
            return
        if norm <= floor:
            running[candidate] = wp.static(CONVERGED)
            return
        mix = wp.float64(0.0)
        if fresh[candidate] == 0:
            mix = wp.max((own - cross) / own_last[candidate], wp.float64(0.0))
        own_last[candidate] = own
        fresh[candidate] = 0
        mix_out[candidate] = scalar(mix)

    @kernel
    def direct(
        # In:
        residual_in: wp.array2d(dtype=vec),
        mix: wp.array(dtype=scalar),
        running: wp.array(dtype=int),
        # Out:
        direction_out: wp.array2d(dtype=vec),
        residual_last_out: wp.array2d(dtype=vec),
    ):
        candidate, particle = wp.tid()
        if running[candidate] != wp.static(RUNNING):
            return
        r = residual_in[candidate, particle]
        m = mix[candidate]
        p = r
        if m != zero:
            p = r + m * direction_out[candidate, particle]
        direction_out[candidate, particle] = p
        residual_last_out[candidate, particle] = r

    @kernel
    def curvature_products(
        # Rest:
        metric: wp.array(dtype=scalar),
        # In:
        residual_in: wp.array2d(dtype=vec),
        direction_in: wp.array2d(dtype=vec),
        stiff_in: wp.array2d(dtype=vec),
        running: wp.array(dtype=int),
        particle_count: int,
        # Out:
        slope_out: wp.array2d(dtype=wp.float64),
        curvature_out: wp.array2d(dtype=wp.float64),
        length_out: wp.array2d(dtype=wp.float64),
        longest_out: wp.array2d(dtype=wp.float64),
    ):
        """Partial sums along a direction p: slope <r, p>, curvature <p, (I - J) p>, length |p|^2 and longest |p_i|^2.

        `stiff_in` holds J p - p, as `goals` leaves it.
        """
        candidate, chunk = wp.tid()
        if running[candidate] != wp.static(RUNNING):
            return
        first = chunk * wp.static(CHUNK)
        slope = wp.float64(0.0)
        curvature = wp.float64(0.0)
        length = wp.float64(0.0)
        longest = wp.float64(0.0)
        for i in range(first, wp.min(first + wp.static(CHUNK), particle_count)):
            p = direction_in[candidate, i]
            own = wp.float64(wp.dot(p, p))
            slope += wp.float64(metric[i] * wp.dot(p, residual_in[candidate, i]))
            curvature -= wp.float64(metric[i] * wp.dot(p, stiff_in[candidate, i]))
            length += wp.float64(metric[i]) * own
            longest = wp.max(longest, own)
        slope_out[candidate, chunk] = slope
        curvature_out[candidate, chunk] = curvature
        length_out[candidate, chunk] = length
        longest_out[candidate, chunk] = longest

    @kernel
    def choose_step(
        # In:
        slope_part: wp.array2d(dtype=wp.float64),
        curvature_part: wp.array2d(dtype=wp.float64),
        length_part: wp.array2d(dtype=wp.float64),
        longest_part: wp.array2d(dtype=wp.float64),
        chunk_count: int,
        metric_total: wp.float64,
        tolerance: wp.float64,
        # In and out:
        path: wp.array(dtype=wp.float64),
        mark: wp.array(dtype=int),
        total: wp.array(dtype=int),
        fresh: wp.array(dtype=int),
        running: wp.array(dtype=int),
        # Out:
        step_out: wp.array(dtype=scalar),
        error_out: wp.array(dtype=wp.float64),
    ):
        """Step length to the minimum of the energy along the direction, by its curvature there.

        Where the energy curves down (a crushed cluster about to turn), the step is that of the plain goal map, which
        never raises the energy, and the direction starts anew. No particle moves more than half a spacing at once.
        The distance still to go is judged by the path over the last quarter of all iterations.
        """
        candidate = wp.tid()
        if running[candidate] != wp.static(RUNNING):
            return
        slope = wp.float64(0.0)
        curvature = wp.float64(0.0)
        length = wp.float64(0.0)
        longest = wp.float64(0.0)
        for chunk in range(chunk_count):
            slope += slope_part[candidate, chunk]
            curvature += curvature_part[candidate, chunk]
            length += length_part[candidate, chunk]
            longest = wp.max(longest, longest_part[candidate, chunk])
        longest = wp.sqrt(longest)
        step = wp.float64(1.0)
        if curvature > flat * length and slope > wp.float64(0.0):
            step = slope / curvature
        else:
            fresh[candidate] = 1
            if slope <= wp.float64(0.0):
                step = wp.float64(0.0)
        if step * longest > wp.float64(0.5):
            step = wp.float64(0.5) / longest
        path[candidate] = path[candidate] + step * wp.sqrt(length / metric_total)
        k = total[candidate]
        if k >= mark[candidate]:
            error_out[candidate] = path[candidate]
            mark[candidate] = k + wp.max(k / 3, 8)
            path[candidate] = wp.float64(0.0)
            if error_out[candidate] <= tolerance:
                running[candidate] = wp.static(CONVERGED)
        step_out[candidate] = scalar(step)

    @kernel
    def take_step(
        # In:
        direction_in: wp.array2d(dtype=vec),
        step: wp.array(dtype=scalar),
        running: wp.array(dtype=int),
        # Out:
        u_out: wp.array2d(dtype=vec),
    ):
        candidate, particle = wp.tid()
        if running[candidate] != wp.static(RUNNING):
            return
        u_out[candidate, particle] = u_out[candidate, particle] + step[candidate] * direction_in[candidate, particle]

    return Kernels(
        fit_changes=fit_changes,
        residual_products=residual_products,
        conjugate=conjugate,
        direct=direct,
        curvature_products=curvature_products,
        choose_step=choose_step,
        take_step=take_step,
        scalar=scalar,
        vec=vec,
        basis_vec=basis_vec,
        transform=transform,
        moment=square,
        predict=predict,
        fit_clusters=fit_clusters,
        goals=goals,
        integrate=integrate,
        remember=remember,
        products=products,
        accelerate=accelerate,
        advance=advance,
        history=history,
        history_vec=history_vec,
    )
