"""Warp functions of one cluster: rotation, volume conservation, and their derivatives. The kernels are made of them."""

import functools
from types import SimpleNamespace
from typing import Any

import warp as wp

from deformscope.stages.msm.lanes import members
from deformscope.stages.msm.reference import MIN_DENOMINATOR, NO_ROTATION


@functools.cache
def functions_for(dim: int, scalar: Any) -> SimpleNamespace:
    """The functions for `dim` = 2 or 3 and scalar = wp.float32 or wp.float64."""
    vec = wp.types.vector(length=dim, dtype=scalar)
    square = wp.types.matrix(shape=(dim, dim), dtype=scalar)
    mat44 = wp.types.matrix(shape=(4, 4), dtype=scalar)
    vec4 = wp.types.vector(length=4, dtype=scalar)
    zero, one, two = scalar(0.0), scalar(1.0), scalar(2.0)
    no_rotation = scalar(NO_ROTATION)
    min_denominator = scalar(MIN_DENOMINATOR)
    # the rotation is accepted when its gradient is this small against the moments; else the eigenvector decides
    accept = scalar(1e-12 if scalar is wp.float64 else 3e-6)
    # of the projection: rounding of a product of columns, a direction lost in it, a step of Newton's that is the last
    # but one, and what is 0 among slopes
    orthogonal = scalar(1e-15 if scalar is wp.float64 else 5e-7)
    lost = scalar(1e-20 if scalar is wp.float64 else 1e-12)
    close = scalar(1e-8 if scalar is wp.float64 else 1e-4)
    tiny = scalar(1e-30)

    @wp.func
    def turn_2d(a_qq: square, change: square):
        """R - I of eq. 3.9 in the plane, for A_pq = a_qq + change: the closed form, without cancellation. Second: the
        compliance of the rotation, d angle = compliance[0, 0] * axial(R^T dA_pq)."""
        s = change[1, 0] - change[0, 1]
        c = a_qq[0, 0] + a_qq[1, 1] + change[0, 0] + change[1, 1]
        size = wp.sqrt(s * s + c * c)
        out = square()
        compliance = square()
        if size > no_rotation * (a_qq[0, 0] + a_qq[1, 1]):
            compliance[0, 0] = one / size
            cosine_less_one = (c - size) / size
            if c > zero:
                cosine_less_one = -s * s / (size * (c + size))
            out[0, 0] = cosine_less_one
            out[1, 1] = cosine_less_one
            out[1, 0] = s / size
            out[0, 1] = -s / size
        return out, compliance

    @wp.func
    def quaternion_turn(q: vec4):
        """R - I of a unit quaternion (w, x, y, z), exact to the last digit for small turns."""
        out = square()
        w, x, y, z = q[0], q[1], q[2], q[3]
        if wp.static(dim == 3):
            out[0, 0] = -two * (y * y + z * z)
            out[1, 1] = -two * (x * x + z * z)
            out[2, 2] = -two * (x * x + y * y)
            out[0, 1] = two * (x * y - w * z)
            out[1, 0] = two * (x * y + w * z)
            out[0, 2] = two * (x * z + w * y)
            out[2, 0] = two * (x * z - w * y)
            out[1, 2] = two * (y * z - w * x)
            out[2, 1] = two * (y * z + w * x)
        return out

    @wp.func
    def largest_quaternion(f: square):
        """The quaternion that maximises tr(R^T F): leading eigenvector of Horn's matrix (Horn 1987), by Jacobi sweeps.

        It is never a reflection, and it is global: used where Newton's steps from rest do not settle."""
        n = mat44()
        v = wp.identity(n=4, dtype=scalar)
        n[0, 0] = f[0, 0] + f[1, 1] + f[2, 2]
        n[1, 1] = f[0, 0] - f[1, 1] - f[2, 2]
        n[2, 2] = f[1, 1] - f[0, 0] - f[2, 2]
        n[3, 3] = f[2, 2] - f[0, 0] - f[1, 1]
        n[0, 1] = f[2, 1] - f[1, 2]
        n[0, 2] = f[0, 2] - f[2, 0]
        n[0, 3] = f[1, 0] - f[0, 1]
        n[1, 2] = f[0, 1] + f[1, 0]
        n[1, 3] = f[0, 2] + f[2, 0]
        n[2, 3] = f[1, 2] + f[2, 1]
        for i in range(4):
            for j in range(i):
                n[i, j] = n[j, i]
        for _sweep in range(10):
            for p in range(3):
                for q in range(p + 1, 4):
                    if n[p, q] != zero:
                        angle = (n[q, q] - n[p, p]) / (two * n[p, q])
                        t = one / (wp.abs(angle) + wp.sqrt(angle * angle + one))
                        if angle < zero:
                            t = -t
                        c = one / wp.sqrt(t * t + one)
                        s = t * c
                        for k in range(4):
                            a = n[k, p]
                            b = n[k, q]
                            n[k, p] = c * a - s * b
                            n[k, q] = s * a + c * b
                        for k in range(4):
                            a = n[p, k]
                            b = n[q, k]
                            n[p, k] = c * a - s * b
                            n[q, k] = s * a + c * b
                        for k in range(4):
                            a = v[k, p]
                            b = v[k, q]
                            v[k, p] = c * a - s * b
                            v[k, q] = s * a + c * b
        best = int(0)
        for k in range(1, 4):
            if n[k, k] > n[best, best]:
                best = k
        return wp.normalize(vec4(v[0, best], v[1, best], v[2, best], v[3, best]))

    @wp.func
    def turn_3d(a_qq: square, change: square):
        """R - I of eq. 3.9 in space, for A_pq = a_qq + change.

        Newton's steps on the rotation from rest (Kugelstadt 2018, 3.2). They end at the required maximum exactly when
        the gradient vanishes and tr(S) I - S is positive definite; if not, the leading eigenvector takes over.
        Second: the compliance (tr(S) I - S)^-1 of the rotation, 0 where none is preferred."""
        q = vec4(one, zero, zero, zero)
        compliance = square()
        size = a_qq[0, 0] + a_qq[1, 1] + a_qq[2, 2] + wp.sqrt(wp.ddot(change, change))
        good = bool(False)
        f = a_qq + change
        for attempt in range(2):
            if attempt == 1 and not good:
                q = largest_quaternion(f)
            if attempt == 0 or not good:
                for _step in range(wp.static(8)):
                    d = quaternion_turn(q)
                    b = f + wp.transpose(d) * f
                    # axial(R^T F); the rest part of F is symmetric and drops out
                    extra = change + wp.transpose(d) * f
                    g0 = extra[2, 1] - extra[1, 2]
                    g1 = extra[0, 2] - extra[2, 0]
                    g2 = extra[1, 0] - extra[0, 1]
                    h00 = b[1, 1] + b[2, 2]
                    h11 = b[0, 0] + b[2, 2]
                    h22 = b[0, 0] + b[1, 1]
                    h01 = -(b[0, 1] + b[1, 0]) / two
                    h02 = -(b[0, 2] + b[2, 0]) / two
                    h12 = -(b[1, 2] + b[2, 1]) / two
                    m00 = h11 * h22 - h12 * h12
                    m01 = h02 * h12 - h01 * h22
                    m02 = h01 * h12 - h02 * h11
                    det = h00 * m00 + h01 * m01 + h02 * m02
                    gradient = wp.sqrt(g0 * g0 + g1 * g1 + g2 * g2)
                    if h00 <= zero or h00 * h11 - h01 * h01 <= zero or det <= no_rotation * h00 * h11 * h22:
                        good = bool(False)
                        compliance = square()
                        break
                    m11 = h00 * h22 - h02 * h02
                    m12 = h01 * h02 - h00 * h12
                    m22 = h00 * h11 - h01 * h01
                    compliance = square(m00, m01, m02, m01, m11, m12, m02, m12, m22) / det
                    if gradient <= accept * size:
                        good = bool(True)
                        break
                    half = compliance * vec(g0, g1, g2) / two
                    w0, w1, w2 = half[0], half[1], half[2]
                    turned = vec4(
                        q[0] - q[1] * w0 - q[2] * w1 - q[3] * w2,
                        q[1] + q[0] * w0 + q[2] * w2 - q[3] * w1,
                        q[2] + q[0] * w1 + q[3] * w0 - q[1] * w2,
                        q[3] + q[0] * w2 + q[1] * w1 - q[2] * w0,
                    )
                    q = wp.normalize(turned)
                    good = gradient <= scalar(100.0) * accept * size
        return quaternion_turn(q), compliance

    turn = turn_2d if dim == 2 else turn_3d

    @wp.func
    def spanned(a: square, span_axes: square, span_count: int):
        """A applied to the axes that a flat cluster spans, and their metric (I beyond)."""
        inside = a * span_axes  # columns beyond span_count are 0
        metric = wp.transpose(inside) * inside
        for k in range(wp.static(dim)):
            if k >= span_count:
                metric[k, k] = one
        return inside, metric

    @wp.func
    def measured(a: square, span_axes: square, span_count: int):
        """Volume, area or length of a cluster's span, and its root: the length of a side."""
        measure = wp.determinant(a)
        if span_count < wp.static(dim):
            _inside, metric = spanned(a, span_axes, span_count)
            measure = wp.sqrt(wp.max(wp.determinant(metric), zero))
        root = wp.pow(wp.abs(measure), one / scalar(wp.max(span_count, 1)))
        if measure < zero:
            root = -root
        return measure, root

    @wp.func
    def volume_denominator(a: square, theta: scalar, span_axes: square, span_count: int):
        """Denominator of eq. 3.17 for the spanned axes; bounded away from 0."""
        _measure, root = measured(a, span_axes, span_count)
        return wp.max(theta * root + (one - theta), min_denominator)

    @wp.func
    def determinant_change(a: square, change: square):
        """d det A for dA = change."""
        total = zero
        for row in range(wp.static(dim)):
            replaced = a
            for column in range(wp.static(dim)):
                replaced[row, column] = change[row, column]
            total += wp.determinant(replaced)
        return total

    @wp.func
    def denominator_change(a: square, change: square, theta: scalar, span_axes: square, span_count: int):
        """Derivative of `volume_denominator` for dA = change; 0 where it is clamped."""
        measure, root = measured(a, span_axes, span_count)
        d_measure = determinant_change(a, change)
        if span_count < wp.static(dim):
            inside, metric = spanned(a, span_axes, span_count)
            half_change = wp.transpose(inside) * (change * span_axes)
            d_measure = zero
            if measure > zero:
                d_measure = determinant_change(metric, half_change + wp.transpose(half_change)) / (two * measure)
        out = zero
        if theta * root + (one - theta) > min_denominator and measure != zero:
            count = scalar(wp.max(span_count, 1))
            out = theta * root / (count * measure) * d_measure
        return out

    @wp.func
    def column_product(a: square, p: int, b: square, q: int):
        total = scalar(0.0)
        for i in range(wp.static(dim)):
            total += a[i, p] * b[i, q]
        return total

    @wp.func
    def rotate_columns(b: square, p: int, q: int, c: scalar, s: scalar):
        """Columns p and q of b as c p - s q and s p + c q."""
        for i in range(wp.static(dim)):
            x = b[i, p]
            y = b[i, q]
            b[i, p] = c * x - s * y
            b[i, q] = s * x + c * y
        return b

    @wp.func
    def orthogonal_columns(b: square, v: square, p: int, q: int):
        """Turn columns p and q of b, and of v with them, so that they are orthogonal, the longer one first."""
        pp = column_product(b, p, b, p)
        qq = column_product(b, q, b, q)
        pq = column_product(b, p, b, q)
        c = one
        s = zero
        turned = bool(False)
        if wp.abs(pq) > orthogonal * wp.sqrt(pp * qq):
            angle = (qq - pp) / (two * pq)
            t = one / (wp.abs(angle) + wp.sqrt(angle * angle + one))
            if angle < zero:
                t = -t
            c = one / wp.sqrt(t * t + one)
            s = t * c
            pp -= t * pq
            qq += t * pq
            turned = bool(True)
        if qq > pp:  # a quarter turn more
            swap = c
            c = s
            s = -swap
            turned = bool(True)
        if turned:
            b = rotate_columns(b, p, q, c, s)
            v = rotate_columns(v, p, q, c, s)
        return b, v, turned

    @wp.func
    def singular_values(b: square):
        """u, s, v with b = u diag(s) v^T, u and v proper rotations: s descends, only the last may be below 0.

        By rotating the columns of b itself (Hestenes 1958): b^T b would lose half of the digits of the smallest value.
        Columns of b that are 0 stay so, and v leaves them alone."""
        size = zero
        for i in range(wp.static(dim)):
            for j in range(wp.static(dim)):
                size = wp.max(size, wp.abs(b[i, j]))
        u = wp.identity(n=dim, dtype=scalar)
        v = wp.identity(n=dim, dtype=scalar)
        s = vec()
        if size > zero:
            b = b / size
            for _sweep in range(12):
                b, v, turned = orthogonal_columns(b, v, 0, 1)
                if wp.static(dim == 3):
                    b, v, turned_02 = orthogonal_columns(b, v, 0, 2)
                    b, v, turned_12 = orthogonal_columns(b, v, 1, 2)
                    turned = turned or turned_02 or turned_12
                if not turned:
                    break
            if wp.static(dim == 3):
                first = wp.normalize(vec(b[0, 0], b[1, 0], b[2, 0]))
                normal = wp.cross(first, vec(b[0, 1], b[1, 1], b[2, 1]))
                if wp.length(normal) <= lost:  # of rank 1: any two directions across
                    axis = vec(one, zero, zero)
                    if wp.abs(first[0]) > scalar(0.6):
                        axis = vec(zero, one, zero)
                    normal = wp.cross(first, axis)
                normal = wp.normalize(normal)
                second = wp.cross(normal, first)
                for i in range(wp.static(dim)):
                    u[i, 0] = first[i]
                    u[i, 1] = second[i]
                    u[i, 2] = normal[i]
            else:
                first = wp.normalize(vec(b[0, 0], b[1, 0]))
                u = square(first[0], -first[1], first[1], first[0])
            for j in range(wp.static(dim)):
                s[j] = column_product(u, j, b, j) * size
        return u, s, v

    @wp.func
    def stretch_root(s: scalar, smallest: scalar, y: scalar):
        """sqrt(s^2 + 4 mu) for mu = y (y - smallest), as a sum of terms that are never negative."""
        away = smallest - two * y
        return wp.sqrt(wp.max((s - smallest) * (s + smallest), zero) + away * away)

    @wp.func
    def smallest_stretch(s: vec, span_count: int, start: scalar):
        """Newton's steps on log(y prod s'_i) = 0, in log y, from `start`; and the squared distance of its stretches.

        The distance is -1 where the steps do not settle: the solution of that side is none."""
        smallest = s[wp.max(span_count - 1, 0)]
        y = start
        distance = -one
        settled = bool(False)
        most = wp.max(s[0], one) + wp.sqrt(one + wp.abs(smallest))
        low = one / (most * most)
        for _step in range(40):
            product = y
            slope = scalar(1.0)
            apart = (y - smallest) * (y - smallest)
            for i in range(wp.static(dim - 1)):
                if i < span_count - 1:
                    root = stretch_root(s[i], smallest, y)
                    stretch = (s[i] + root) / two
                    product *= stretch
                    slope += y * (two * y - smallest) / wp.max(stretch * root, tiny)
                    apart += (stretch - s[i]) * (stretch - s[i])
            if settled:
                distance = apart
                break
            if slope <= tiny:
                break
            excess = wp.log(product)
            # quadratic convergence: after a step this short, the next would be lost in rounding
            settled = wp.abs(excess) <= close * slope
            y = wp.clamp(y * wp.exp(-excess / slope), low, wp.max(one, smallest))
        return y, distance

    @wp.func
    def nearest_stretches(s: vec, span_count: int):
        """The span_count positive numbers of product 1 nearest to the first of s, and mu: s' - mu / s' = s.

        As in the reference: one equation for the smallest, y. Its largest solution is at most 1 and is reached from
        there. A second one, below s_k / 2, can be the nearer one where the product of s is above 2; it is reached from
        the left."""
        smallest = s[wp.max(span_count - 1, 0)]
        product = one
        for i in range(wp.static(dim - 1)):
            if i < span_count - 1:
                product *= s[i]
        y = one
        distance = -one
        if smallest < two:
            y, distance = smallest_stretch(s, span_count, one)
        if product * smallest > two and span_count > 1:
            y_low, distance_low = smallest_stretch(s, span_count, one / product)
            if distance < zero or (distance_low >= zero and distance_low < distance):
                y = y_low
        out = vec()
        for i in range(wp.static(dim)):
            out[i] = one  # never divided by 0 where nothing is spanned
            if i < span_count - 1:
                out[i] = (s[i] + stretch_root(s[i], smallest, y)) / two
            if i == span_count - 1:
                out[i] = y
        return out, y * (y - smallest)

    @wp.func
    def project(b: square, span_count: int):
        """From b to the nearest matrix of measure 1 (`reference.project_measure`), less b, and its frame.

        Only the first span_count columns of b may differ from 0. With b + change = u diag(stretch) v^T, u and v proper,
        change = mu u diag(1 / stretch) v^T over those columns. Returns change, u, v, stretch, mu: the input of
        `project_change`. Finite for every b whose squares are.
        """
        u, s, v = singular_values(b)
        stretch, mu = nearest_stretches(s, span_count)
        change = square()
        for k in range(wp.static(dim)):
            if k < span_count:
                by = mu / stretch[k]
                for i in range(wp.static(dim)):
                    for j in range(wp.static(dim)):
                        change[i, j] = change[i, j] + by * u[i, k] * v[j, k]
        return change, u, v, stretch, mu

    @wp.func
    def project_change(u: square, v: square, stretch: vec, mu: scalar, span_count: int, change: square):
        """How the first answer of `project` changes with b, for db = change (0 beyond its first span_count columns).

        With x = u^T dP v and m = u^T db v, dP that of the nearest matrix, from P - mu P^-T = b and d det P = 0:
        - x_ij + w x_ji = m_ij off the diagonal, w = mu / (s'_i s'_j): symmetric and antisymmetric part on their own
        - on it z_i = x_ii / s'_i has the sum 0 and (s'_i^2 + mu) z_i = s'_i m_ii + dmu
        - x_ij (1 - mu / s'_j^2) = m_ij for directions i that a flat cluster does not span If one of these denominators
        vanishes, two answers are equally near; there x is 0, and the answer does not change."""
        m = wp.transpose(u) * change * v
        x = square()
        for i in range(wp.static(dim)):
            for j in range(wp.static(dim)):
                if i < j and j < span_count:
                    w = mu / (stretch[i] * stretch[j])
                    even = zero
                    odd = zero
                    if one + w > no_rotation:
                        even = (m[i, j] + m[j, i]) / (two * (one + w))
                    if one - w > no_rotation:
                        odd = (m[i, j] - m[j, i]) / (two * (one - w))
                    x[i, j] = even + odd
                    x[j, i] = even - odd
                if i >= span_count and j < span_count:
                    w = mu / (stretch[j] * stretch[j])
                    if one - w > no_rotation:
                        x[i, j] = m[i, j] / (one - w)
        h = vec()
        n = vec()
        for i in range(wp.static(dim)):
            h[i] = stretch[i] * stretch[i] + mu
            n[i] = stretch[i] * m[i, i]
        if span_count == 2:
            total = h[0] + h[1]
            if total > no_rotation * (wp.abs(h[0]) + wp.abs(h[1])):
                z = (n[0] - n[1]) / total
                x[0, 0] = stretch[0] * z
                x[1, 1] = -stretch[1] * z
        if wp.static(dim == 3):
            total_3 = h[0] * h[1] + h[1] * h[2] + h[2] * h[0]
            size_3 = wp.abs(h[0] * h[1]) + wp.abs(h[1] * h[2]) + wp.abs(h[2] * h[0])
            if span_count == 3 and total_3 > no_rotation * size_3:
                z01 = h[2] * (n[0] - n[1]) / total_3
                z12 = h[0] * (n[1] - n[2]) / total_3
                z20 = h[1] * (n[2] - n[0]) / total_3
                x[0, 0] = stretch[0] * (z01 - z20)
                x[1, 1] = stretch[1] * (z12 - z01)
                x[2, 2] = stretch[2] * (z20 - z12)
        return u * x * wp.transpose(v) - change

    return members(
        *(volume_denominator, denominator_change, singular_values, project, project_change),
        turn=turn,
        vec=vec,
        square=square,
    )
