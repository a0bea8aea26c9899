/* The second-order scheme of src/plant/body.rs in plain C: the plant's speed is compared with it.
 *
 * A carriage on four LuGre guides with their own parameters under a held force, without effects and
 * without flexure. Same algebra and same outputs as the Rust plant, in loops over the guides that
 * the compiler can vectorise; exp is the C library's. SI units. benches/plant.rs compiles this
 * file, checks that both give the same motion, and times both. */

#include <math.h>
#include <stdint.h>

#define GUIDES 4

struct stage {
    double step;                     /* s */
    double inverse_mass;             /* 1/kg */
    double viscous_friction;         /* sum of sigma2, N s/m */
    double stiffness[GUIDES];        /* sigma0, N/m */
    double compliance[GUIDES];       /* 1/sigma0 */
    double bristle_damping[GUIDES];  /* sigma1, N s/m */
    double coulomb_force[GUIDES];    /* Fc, N */
    double stribeck_force[GUIDES];   /* Fs - Fc, N */
    double exponent[GUIDES];         /* -1/vs^2, s^2/m^2 */
    double bristle[GUIDES];          /* z, m */
    double position;                 /* m */
    double velocity;                 /* m/s */
    double cell_force;               /* N */
    /* Friction at the start of the next step: start_elastic + start_damping v - start_slip |v|. */
    double start_elastic;            /* sum of sigma0 z, N */
    double start_damping;            /* sum of sigma1 + sigma2, N s/m */
    double start_slip;               /* sum of sigma1 sigma0 z / g, N s/m */
};

static inline void prepare_start(struct stage *s, const double *level)
{
    s->start_elastic = 0.0;
    s->start_damping = s->viscous_friction;
    s->start_slip = 0.0;
    for (int i = 0; i < GUIDES; i++) {
        double elastic = s->stiffness[i] * s->bristle[i];
        s->start_elastic += elastic;
        s->start_damping += s->bristle_damping[i];
        s->start_slip += s->bristle_damping[i] / level[i] * elastic;
    }
}

static inline double start_force(const struct stage *s)
{
    return s->start_elastic + s->start_damping * s->velocity - s->start_slip * fabs(s->velocity);
}

/* Moves the carriage over `span` seconds: bristles exactly at the velocity of the middle, Simpson's
 * rule for the position. */
static inline void move(struct stage *s, double force, double acceleration, double span)
{
    double start = s->velocity;
    double v = start + 0.5 * span * acceleration;
    double squared = v * v, distance = fabs(v) * span, sign = copysign(1.0, v);
    double level[GUIDES];
    double early = 0.0, late = 0.0;

    for (int i = 0; i < GUIDES; i++)
        level[i] = s->coulomb_force[i] + s->stribeck_force[i] * exp(s->exponent[i] * squared);
    for (int i = 0; i < GUIDES; i++) {
        double decay = exp(-s->stiffness[i] * distance / level[i]);
        double steady = level[i] * s->compliance[i] * sign;
        double excess = s->bristle[i] - steady;
        double half = s->stiffness[i] * (0.5 * span);
        double of_start = half - s->bristle_damping[i], of_end = half + s->bristle_damping[i];
        early += of_start * s->bristle[i] + of_end * steady;
        late += of_end * excess * decay;
        s->bristle[i] = steady + excess * decay;
    }
    s->velocity = start + s->inverse_mass * span * (force - s->viscous_friction * v)
        - s->inverse_mass * (early + late);
    s->position += span / 6.0 * (start + 4.0 * v + s->velocity);
    prepare_start(s, level);
}

/* Starts from position, velocity and bristles as they are set. */
void lugre_start(struct stage *s)
{
    double level[GUIDES];
    for (int i = 0; i < GUIDES; i++) {
        double bell = exp(s->exponent[i] * s->velocity * s->velocity);
        level[i] = s->coulomb_force[i] + s->stribeck_force[i] * bell;
    }
    prepare_start(s, level);
}

/* Advances by `steps` steps under the constant force, N. A step in which the carriage reverses is
 * done in two parts. */
void lugre_advance(struct stage *s, double force, uint32_t steps)
{
    for (uint32_t k = 0; k < steps; k++) {
        double acceleration = (force - start_force(s)) * s->inverse_mass;
        double start = s->velocity, end = start + s->step * acceleration;
        if (start * end < 0.0) {
            double before = s->step * start / (start - end);
            move(s, force, acceleration, before);
            acceleration = (force - start_force(s)) * s->inverse_mass;
            move(s, force, acceleration, s->step - before);
        } else {
            move(s, force, acceleration, s->step);
        }
        s->cell_force = force;
    }
}
