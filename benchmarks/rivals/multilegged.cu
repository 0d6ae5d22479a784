// The chain of four legs in CUDA C++: a thread owns a trajectory, its state stays in registers.
//
// Each turn of the loop is one classic RK4 step of every thread of a warp; only what an event needs is
// branched to, since a warp that closed in on one thread's event would let 31 wait. Modes are small integers:
// what a leg's segment and contact make of it is selected anew at each use, by the pipe that double precision
// leaves idle. Heights x are measured from L (m), phases q from the end of their segment (rad, negative until
// it ends): a leg's length is slope * q + foot. As in multilegged_simd.c, RK4's sums are written out.

#ifndef BLOCK
#define BLOCK 128
#endif
#ifndef BLOCKS_AN_SM
#define BLOCKS_AN_SM 3
#endif
#define EACH_LEG _Pragma("unroll") for (int i = 0; i < LEGS; i++)
#define INLINED __device__ __forceinline__

constexpr int LEGS = 4, GUARDS = 8, LANDING = 2, SECANT_TRIALS = 24, PATIENT_TRIALS = 60;
constexpr double FIRST_STEP = 0.125, GROWTH = 1.25, TURN = 6.283185307179586476925;
constexpr double STRICTLY = 1e-300;  // x = l switches no contact
constexpr double NONE = 1e300;       // the far end of a bracket that is none

struct Table {
    double kappa, sigma, K, D, omega, rate, g, dt, tolerance, inverse_mass[LEGS];
    double ends[3], extents[3], slopes[3], feet[3];  // of each segment, see c_simd.py
};

struct State {
    double x[LEGS], v[LEGS], q[LEGS], y[LEGS];
    int segment[LEGS];
    bool contact[LEGS];
};

struct Line {
    double slope, foot;
};

INLINED Line line(const Table &p, int segment) {
    double slope = segment == LANDING ? p.slopes[LANDING] : segment ? p.slopes[1] : 0.0;
    return {slope, segment == 1 ? p.feet[1] : 0.0};
}

// By the sign bit alone, as an integer's: no work for the pipe of double precision.
INLINED bool fires(double guard) { return __double2hiint(guard) >= 0; }

INLINED double with_sign(double value, bool kept) {
    return __hiloint2double(__double2hiint(value) ^ (kept ? 0 : 0x80000000), __double2loint(value));
}

INLINED double gap_guard(const Table &p, const State &s, int i) {
    Line leg = line(p, s.segment[i]);
    double gap = s.x[i] - (leg.slope * s.q[i] + leg.foot);
    return with_sign(gap, s.contact[i]) - STRICTLY;
}

INLINED State rk4(const Table &p, const State &s, double h) {
    constexpr double sixth = 1.0 / 6.0;
    double half = 0.5 * h;
    // y at the four stages, as a share of y at the first
    double two = 1.0 - half * p.rate, three = 1.0 - half * p.rate * two, four = 1.0 - h * p.rate * three;
    double share[4] = {1.0, two, three, four}, mean = (1.0 + 2.0 * (two + three) + four) * h * sixth;
    double x[LEGS], v[LEGS], leg[LEGS], turn[LEGS], start[LEGS], drift[LEGS], lag[LEGS];
    double a[LEGS], inner[LEGS], all[LEGS], spring[LEGS], damper[LEGS];
    EACH_LEG {
        Line at = line(p, s.segment[i]);
        x[i] = s.x[i];
        v[i] = s.v[i];
        start[i] = leg[i] = at.slope * s.q[i] + at.foot;
        drift[i] = at.slope * p.omega;
        lag[i] = at.slope * s.y[i];
        spring[i] = s.contact[i] ? p.K : 0.0;
        damper[i] = s.contact[i] ? p.D : 0.0;
    }
#pragma unroll
    for (int stage = 0; stage < 4; stage++) {
        double pull[LEGS], force[LEGS], step = stage == 2 ? h : half;
        EACH_LEG pull[i] = p.kappa * x[i] + p.sigma * v[i];
        force[0] = pull[1] - pull[0];
        force[1] = pull[2] - pull[1] - force[0];
        force[3] = pull[2] - pull[3];
        force[2] = pull[1] - pull[2] - force[3];
        EACH_LEG {
            turn[i] = stage == 0 ? drift[i] + lag[i] : drift[i] + lag[i] * share[stage];
            force[i] -= spring[i] * (x[i] - leg[i]);
            force[i] -= damper[i] * (v[i] - turn[i]);
            a[i] = force[i] * p.inverse_mass[i] - p.g;
            inner[i] = stage == 0 ? 0.0 : stage == 3 ? inner[i] : stage == 1 ? a[i] : inner[i] + a[i];
            all[i] = stage == 0 ? a[i] : all[i] + a[i];
            x[i] = s.x[i] + step * v[i];
            v[i] = s.v[i] + step * a[i];
            leg[i] = start[i] + step * turn[i];
        }
    }
    State end = s;
    EACH_LEG {
        end.x[i] = s.x[i] + h * (s.v[i] + h * sixth * (all[i] - a[i]));
        end.v[i] = s.v[i] + h * sixth * (all[i] + inner[i]);
        end.q[i] = s.q[i] + (h * p.omega + mean * s.y[i]);
        end.y[i] = s.y[i] - mean * p.rate * s.y[i];
    }
    return end;
}

// The jump of eq. (5), (6) and of the segments of eq. (3); true where it closes a cycle.
INLINED bool jump(const Table &p, State &s, const double *gaps, bool &landed) {
    bool closed = false;
    EACH_LEG {
        bool ended = fires(s.q[i]), wraps = ended && s.segment[i] == LANDING;
        if (ended) {
            s.segment[i] = wraps ? 0 : s.segment[i] + 1;
            s.q[i] -= wraps ? p.extents[0] : p.extents[1];
        }
        bool switched = fires(gaps[i]), kicked = switched && !s.contact[i] && s.segment[i] == LANDING;
        if (kicked) s.y[i] -= s.q[i] * p.rate;
        s.contact[i] = s.contact[i] != switched;
        if (i == 0) {
            closed = !landed && (kicked || wraps);
            landed = (landed || kicked) && !wraps;
        }
    }
    return closed;
}

INLINED void keep(const Table &p, const State &s, double t, double *kept) {
    double phi[LEGS];
    EACH_LEG phi[i] = s.q[i] + p.ends[s.segment[i]];
    kept[0] = t;
#pragma unroll
    for (int i = 1; i < LEGS; i++) {
        double psi = phi[i] - phi[i - 1];
        kept[i] = psi - TURN * floor(psi / TURN);
    }
}

// starts: rows x (x, v, q, y of each leg); modes: rows x (contact, segment of each leg), leg 1 has landed;
// found: rows x crossings x (t, psi_1, psi_2, psi_3); attempts: rows.
extern "C" __global__ void __launch_bounds__(BLOCK, BLOCKS_AN_SM)
    sweep(const Table p, int rows, int crossings, int limit, const double *__restrict__ starts,
          const int *__restrict__ modes, double *__restrict__ found, long long *__restrict__ attempts) {
    __shared__ double far_guards[GUARDS][BLOCK];
    const int lane = threadIdx.x;
    const long long row = (long long)blockIdx.x * BLOCK + lane;
    if (row >= rows) return;
    State s;
    EACH_LEG {
        const double *z = starts + row * 4 * LEGS + i;
        s.x[i] = z[0], s.v[i] = z[LEGS], s.q[i] = z[2 * LEGS], s.y[i] = z[3 * LEGS];
        s.contact[i] = modes[row * 2 * LEGS + i] != 0;
        s.segment[i] = modes[row * 2 * LEGS + LEGS + i];
    }
    double t = 0.0, h = 0.0, pace = 0.0, far = NONE;
    float weight = 1.0f;  // Illinois: of the end that stayed; above zero the near one, below it the far one
    int trials = 0, tried = 0, count = 0;
    bool landed = true;
    while (tried < limit) {
        tried++;
        State trial = rk4(p, s, h);
        double gaps[LEGS];
        EACH_LEG gaps[i] = gap_guard(p, trial, i);
        bool hit = false;
        EACH_LEG hit = hit || fires(trial.q[i]) || fires(gaps[i]);
        if (!hit && far == NONE) {
            s = trial;
            t += h;
            double grown = GROWTH * pace < p.dt ? GROWTH * pace : p.dt;
            h = pace = h > 0.0 ? grown : FIRST_STEP * p.dt;
            trials = 0;
            continue;
        }
        // the guard whose secant crosses zero first: how far below zero at the near end, above it at the far
        double below = 1.0, above = 0.0;
#pragma unroll
        for (int j = 0; j < GUARDS; j++) {
            double there = j < LEGS ? trial.q[j] : gaps[j - LEGS];
            double here = j < LEGS ? s.q[j] : gap_guard(p, s, j - LEGS);
            double beyond = hit ? there : far_guards[j][lane], near = hit ? here : there;
            if (!fires(beyond)) continue;
            double low = near < 0.0 ? -near : 0.0;
            bool first = low * above < below * beyond;
            below = first ? low : below;
            above = first ? beyond : above;
        }
        double late = trials > PATIENT_TRIALS ? trials - PATIENT_TRIALS : 0;
        double tolerance = p.tolerance * (1.0 + late * late);
        if (hit && h * above <= tolerance * (below + above)) {
            s = trial;
            t += h;
            if (jump(p, s, gaps, landed)) {
                keep(p, s, t, found + (row * crossings + count) * LEGS);
                if (++count == crossings) break;
            }
            h = 0.0, far = NONE, trials = 0;
            continue;
        }
        trials++;
        if (hit) {
            weight = far == NONE ? 1.0f : weight > 0.0f ? 0.5f * weight : 1.0f;
            far = h;
#pragma unroll
            for (int j = 0; j < GUARDS; j++) far_guards[j][lane] = j < LEGS ? trial.q[j] : gaps[j - LEGS];
        } else {
            s = trial;
            t += h;
            weight = weight < 0.0f ? 0.5f * weight : -1.0f;
            far = far > h ? far - h : NONE;
            if (far == NONE) {
                h = pace = GROWTH * pace < p.dt ? GROWTH * pace : p.dt;
                continue;
            }
        }
        // the next trial on the way to the event: half a tolerance past the weighted secant's root
        below *= weight > 0.0f ? weight : 1.0f;
        above *= weight < 0.0f ? -weight : 1.0f;
        double secant = far * (below / (below + above)) + 0.5 * tolerance;
        h = trials > SECANT_TRIALS ? 0.5 * far : secant < far ? secant : far;
        if (far <= tolerance) h = far;
    }
    attempts[row] = tried;
}
