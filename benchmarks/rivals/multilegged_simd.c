// The chain of four legs in C: eight trajectories side by side in the lanes of a vector register, each with a
// time and a step of its own. An attempt is one classic RK4 step of all eight without a branch; where a lane
// has met an event or is closing in on one, a second loop of selects moves its bracket, and lanes that landed
// on their event jump one by one. A lane that has seen its crossings takes the next start from a counter that
// all threads share. Heights x are measured from L (m), phases q from the end of their segment (rad, negative
// until it ends): a leg's length is slope * q + foot. RK4's sums are written out where they are known
// beforehand: the lags y shrink by the same factor in all legs, and x gains h v + h^2/6 (a1 + a2 + a3).

#include <math.h>
#include <stdint.h>

enum { LEGS = 4, LANES = 8, GUARDS = 8, LANDING = 2, SECANT_TRIALS = 24, PATIENT_TRIALS = 60 };
enum { X = 0, V = 4, Q = 8, Y = 12, FIELDS = 16 };  // where the legs' heights, speeds, phases, lags begin
static const double FIRST_STEP = 0.125, GROWTH = 1.25, TURN = 2.0 * M_PI, TINY = 1e-300;

#define UP_TO(n, i) _Pragma("GCC unroll 16") for (int i = 0; i < (n); i++)
#define EACH_LANE _Pragma("omp simd simdlen(8)") for (int k = 0; k < LANES; k++)
#define APART __attribute__((noinline)) static  // inlined, these three make one slower whole

typedef double Lanes[LANES];
typedef struct {
    double kappa, sigma, K, D, omega, rate, g, dt, tolerance, inverse_mass[LEGS];
    double ends[3], extents[3], slopes[3], feet[3];  // of each segment, see c_simd.py
} Table;

typedef struct {
    Lanes z[FIELDS], guards[GUARDS], highest;  // the highest of the guards
} __attribute__((aligned(64))) Motion;

typedef struct {
    Lanes slope[LEGS], foot[LEGS], spring[LEGS], damper[LEGS], sign[LEGS], far_guards[GUARDS];
    Lanes dt, t, h, pace, far, weight, trials, lands;  // dt is zero in an idle lane
    int segment[LEGS][LANES], contact[LEGS][LANES], landed[LANES];
    int64_t row[LANES], count[LANES], born[LANES];
} __attribute__((aligned(64))) Group;

typedef struct {
    int64_t rows, crossings, limit, next;  // next: the first row that no lane has taken yet
    const double *starts;  // rows x (x, v, q, y of each leg)
    const int32_t *modes;  // rows x (contact, segment of each leg); leg 1 has landed
    double *found;         // rows x crossings x (t, psi_1, psi_2, psi_3)
    int64_t *attempts;     // rows
} Sweep;

// As one instruction each, which fmax and fmin are not: they care for NaN.
static inline double larger(double a, double b) { return a > b ? a : b; }
static inline double smaller(double a, double b) { return a < b ? a : b; }

static void set_modes(const Table *p, Group *b, int i, int k) {
    int segment = b->segment[i][k], contact = b->contact[i][k];
    b->slope[i][k] = p->slopes[segment];
    b->foot[i][k] = p->feet[segment];
    b->spring[i][k] = contact ? p->K : 0.0;
    b->damper[i][k] = contact ? p->D : 0.0;
    b->sign[i][k] = contact ? 1.0 : -1.0;
}

// Gives lane k the next start; where there is none, leaves it idle, making steps of no length.
static int load(const Table *p, Sweep *s, Group *b, Motion *m, int k, int64_t now) {
    int64_t next = __atomic_fetch_add(&s->next, 1, __ATOMIC_RELAXED), row = next < s->rows ? next : 0;
    int busy = next < s->rows;
    b->row[k] = busy ? row : -1;
    b->dt[k] = busy ? p->dt : 0.0;
    b->t[k] = b->h[k] = b->pace[k] = b->trials[k] = 0.0;
    b->far[k] = INFINITY;
    b->weight[k] = b->landed[k] = 1;
    b->count[k] = 0;
    b->born[k] = now;
    for (int f = 0; f < FIELDS; f++) m->z[f][k] = s->starts[row * FIELDS + f];
    for (int i = 0; i < LEGS; i++) {
        b->contact[i][k] = s->modes[row * 2 * LEGS + i];
        b->segment[i][k] = s->modes[row * 2 * LEGS + LEGS + i];
        set_modes(p, b, i, k);
    }
    return busy;
}

// One RK4 step of every lane from `from` to `to`, and the guards there; above zero where some lane needs
// more than a plain step: it has met an event, or is closing in on one.
APART int propose(const Table *p, const Group *restrict b, const Motion *restrict from, Motion *restrict to) {
    double sixth = 1.0 / 6.0, rate = p->rate, rare = 0.0;
#pragma omp simd simdlen(8) reduction(+ : rare)
    for (int k = 0; k < LANES; k++) {
        double h = b->h[k], half = 0.5 * h, highest = -1.0;
        double x[LEGS], v[LEGS], at_x[LEGS], at_v[LEGS], leg[LEGS], at_leg[LEGS], turn[LEGS];
        double drift[LEGS], lag[LEGS], a[LEGS], inner[LEGS], all[LEGS];
        // y at the four stages, as a share of y at the first
        double two = 1.0 - half * rate, three = 1.0 - half * rate * two, four = 1.0 - h * rate * three;
        double share[4] = {1.0, two, three, four}, mean = (1.0 + 2.0 * (two + three) + four) * h * sixth;
        UP_TO(LEGS, i) {
            x[i] = at_x[i] = from->z[X + i][k];
            v[i] = at_v[i] = from->z[V + i][k];
            leg[i] = at_leg[i] = b->slope[i][k] * from->z[Q + i][k] + b->foot[i][k];
            drift[i] = b->slope[i][k] * p->omega;
            lag[i] = b->slope[i][k] * from->z[Y + i][k];
        }
        UP_TO(4, stage) {
            double pull[LEGS], force[LEGS], step = stage == 2 ? h : half;
            UP_TO(LEGS, i) pull[i] = p->kappa * at_x[i] + p->sigma * at_v[i];
            force[0] = pull[1] - pull[0];
            force[1] = pull[2] - pull[1] - force[0];
            force[3] = pull[2] - pull[3];
            force[2] = pull[1] - pull[2] - force[3];
            UP_TO(LEGS, i) {
                turn[i] = drift[i] + lag[i] * share[stage];
                force[i] -= b->spring[i][k] * (at_x[i] - at_leg[i]);
                force[i] -= b->damper[i][k] * (at_v[i] - turn[i]);
                a[i] = force[i] * p->inverse_mass[i] - p->g;
                inner[i] = stage == 0 ? 0.0 : stage == 3 ? inner[i] : stage == 1 ? a[i] : inner[i] + a[i];
                all[i] = stage == 0 ? a[i] : all[i] + a[i];
                at_x[i] = x[i] + step * at_v[i];
                at_v[i] = v[i] + step * a[i];
                at_leg[i] = leg[i] + step * turn[i];
            }
        }
        UP_TO(LEGS, i) {
            double y = from->z[Y + i][k], q = from->z[Q + i][k] + (h * p->omega + mean * y);
            double end = x[i] + h * (v[i] + h * sixth * (all[i] - a[i]));
            // x = l switches no contact
            double contact = b->sign[i][k] * (end - (b->slope[i][k] * q + b->foot[i][k])) - TINY;
            to->z[X + i][k] = end;
            to->z[V + i][k] = v[i] + h * sixth * (all[i] + inner[i]);
            to->z[Q + i][k] = to->guards[i][k] = q;
            to->z[Y + i][k] = y - mean * rate * y;
            to->guards[LEGS + i][k] = contact;
            highest = larger(larger(q, contact), highest);
        }
        to->highest[k] = highest;
        rare += (highest >= 0.0) | (b->far[k] < INFINITY) ? 1.0 : 0.0;
    }
    return rare > 0.0;
}

// Every lane after a step that was plain for all.
static void go_on(Group *b) {
    EACH_LANE {
        double grown = smaller(GROWTH * b->pace[k], b->dt[k]);
        b->t[k] += b->h[k];
        b->h[k] = b->pace[k] = b->h[k] == 0.0 ? FIRST_STEP * b->dt[k] : grown;
    }
}

// Of two guards (i, j), the one whose secant crosses zero first takes the place of the first.
#define FIRST_OF(i, j)                                                                                   \
    { double lead = below[i] * above[j] - below[j] * above[i];                                           \
      below[i] = lead > 0.0 ? below[j] : below[i], above[i] = lead > 0.0 ? above[j] : above[i]; }

// Every lane after any other step: its bracket, its next step, and whether it lands on its event. A lane
// whose trial goes too far past the event keeps the state that it had.
APART void locate(const Table *p, Group *restrict b, const Motion *restrict from, Motion *restrict to) {
    EACH_LANE {
        double h = b->h[k], far = b->far[k], weight = b->weight[k], trials = b->trials[k], pace = b->pace[k];
        double below[GUARDS], above[GUARDS], highest = to->highest[k];
        UP_TO(GUARDS, j) {
            double here = from->guards[j][k], there = to->guards[j][k], kept = b->far_guards[j][k];
            double near = highest < 0.0 ? there : here, beyond = highest < 0.0 ? kept : there;
            below[j] = beyond >= 0.0 ? larger(-near, 0.0) : 1.0;
            above[j] = larger(beyond, 0.0);
        }
        UP_TO(4, j) FIRST_OF(j, j + 4);
        UP_TO(2, j) FIRST_OF(j, j + 2);
        FIRST_OF(0, 1);
        double rise = larger(below[0] + above[0], TINY), impatience = larger(trials - PATIENT_TRIALS, 0.0);
        double tolerance = p->tolerance * (1.0 + impatience * impatience);
        // 1: no event; 0: past it, as near as it should be; -1: too far, back
        double verdict = highest < 0.0 ? 1.0 : h * (above[0] / rise) <= tolerance ? 0.0 : -1.0;
        double fresh = far < INFINITY ? 0.0 : 1.0, rest = far - h > 0.0 ? far - h : INFINITY;
        far = b->far[k] = verdict < 0.0 ? h : verdict > 0.0 ? rest : INFINITY;
        // Illinois: the end of the bracket that stays is worth half as much each time
        double side = verdict < 0.0 ? 1.0 : -1.0, stale = side * weight > 0.0 ? 0.5 * weight : side;
        weight = b->weight[k] = fresh > 0.0 ? 1.0 : stale;
        trials = b->trials[k] = verdict == 0.0 ? 0.0 : fresh * verdict > 0.0 ? 0.0 : trials + 1.0;
        UP_TO(FIELDS, f) to->z[f][k] = verdict < 0.0 ? from->z[f][k] : to->z[f][k];
        UP_TO(GUARDS, j) b->far_guards[j][k] = verdict < 0.0 ? to->guards[j][k] : b->far_guards[j][k];
        UP_TO(GUARDS, j) to->guards[j][k] = verdict < 0.0 ? from->guards[j][k] : to->guards[j][k];
        double span = far < INFINITY ? far : 0.0;
        double low = weight > 0.0 ? weight * below[0] : below[0];
        double high = weight < 0.0 ? -weight * above[0] : above[0];
        double secant = span * (low / larger(low + high, TINY)) + 0.5 * tolerance;
        double guess = trials > SECANT_TRIALS ? 0.5 * span : smaller(secant, span);
        guess = span <= tolerance ? span : guess;
        // a step cut short by an event says nothing of how far the next may go
        double grown = span > 0.0 ? pace : smaller(GROWTH * pace, b->dt[k]);
        pace = b->pace[k] = verdict == 0.0 ? FIRST_STEP * b->dt[k] : h == 0.0 ? FIRST_STEP * b->dt[k] : grown;
        b->t[k] += verdict < 0.0 ? 0.0 : h;
        b->h[k] = verdict == 0.0 ? 0.0 : span > 0.0 ? guess : pace;
        b->lands[k] = verdict == 0.0 ? 1.0 : 0.0;
    }
}

// The jump of lane k, eq. (5), (6) and the segments of eq. (3); true where it closes a cycle.
static int jump(const Table *p, Group *b, Motion *m, int k) {
    int closed = 0;
    for (int i = 0; i < LEGS; i++) {
        int ended = m->guards[i][k] >= 0.0, switched = m->guards[LEGS + i][k] >= 0.0;
        int wraps = ended && b->segment[i][k] == LANDING;
        if (ended) {
            b->segment[i][k] = (b->segment[i][k] + 1) % 3;
            m->z[Q + i][k] -= p->extents[b->segment[i][k]];
        }
        b->contact[i][k] ^= switched;
        int kicked = switched && b->contact[i][k] && b->segment[i][k] == LANDING;
        if (kicked) m->z[Y + i][k] -= m->z[Q + i][k] * p->rate;
        if (i == 0) {
            closed = !b->landed[k] && (kicked || wraps);
            b->landed[k] = (b->landed[k] || kicked) && !wraps;
        }
        if (ended || switched) set_modes(p, b, i, k);
    }
    return closed;
}

static void keep(const Table *p, Sweep *s, Group *b, const Motion *m, int k) {
    double *kept = s->found + (b->row[k] * s->crossings + b->count[k]++) * LEGS, phi[LEGS];
    for (int i = 0; i < LEGS; i++) phi[i] = m->z[Q + i][k] + p->ends[b->segment[i][k]];
    kept[0] = b->t[k];
    for (int i = 1; i < LEGS; i++) kept[i] = phi[i] - phi[i - 1] - TURN * floor((phi[i] - phi[i - 1]) / TURN);
}

// One thread's share: eight lanes until there are no starts left.
static void work(const Table *p, Sweep *s) {
    Group b = {0};
    Motion motions[2] = {0};
    int64_t now = 0;
    int busy = 0;
    for (int k = 0; k < LANES; k++) busy += load(p, s, &b, motions, k, now);
    while (busy > 0 && now < s->limit * s->rows) {
        const Motion *from = &motions[now++ & 1];
        Motion *to = &motions[now & 1];
        int rare = propose(p, &b, from, to);
        if (rare) locate(p, &b, from, to);
        else go_on(&b);
        for (int k = 0; k < LANES && rare; k++) {
            if (b.lands[k] == 0.0 || b.row[k] < 0) continue;
            if (jump(p, &b, to, k)) keep(p, s, &b, to, k);
            if (b.count[k] == s->crossings || now - b.born[k] > s->limit) {
                s->attempts[b.row[k]] = now - b.born[k];
                busy += load(p, s, &b, to, k, now) - 1;
            }
        }
    }
}

void run(const Table *p, Sweep *s) {
#pragma omp parallel
    work(p, s);
}
