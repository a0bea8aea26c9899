/* The second-order scheme of src/plant/body.rs in plain C: the yardstick for the speed of the plant.
 *
 * A carriage on four LuGre guides with their own parameters under a held force, without effects and without flexure.
 * Same algebra and same outputs as the Rust plant; exp is the C library's. SI units throughout. benches/plant.rs
 * compiles this file, checks that both give the same motion, and times both. */

#include <math.h>
#include <stdint.h>

#define GUIDES 4

struct guide {
    double stiffness;        /* sigma0, N/m */
    double compliance;       /* 1/sigma0 */
    double bristle_damping;  /* sigma1, N s/m */
    double coulomb_force;    /* Fc, N */
    double stribeck_force;   /* Fs - Fc, N */
    double exponent;         /* -1/vs^2, s^2/m^2 */
    double bristle;          /* z, m */
    double inverse_level;    /* 1/g as of the middle of the last step, 1/N */
};

struct stage {
    double step;             /* s */
    double inverse_mass;     /* 1/kg */
    double viscous_friction; /* sum of sigma2, N s/m */
    double position;         /* m */
    double velocity;         /* m/s */
    double cell_force;       /* N */
    struct guide guides[GUIDES];
};

/* Friction at the start of a step, N, with the Stribeck level of the last step's middle. */
static inline double start_force(const struct stage *stage)
{
    double v = stage->velocity, force = stage->viscous_friction * v;
    for (int i = 0; i < GUIDES; i++) {
        const struct guide *g = &stage->guides[i];
        double elastic = g->stiffness * g->bristle;
        force += elastic + g->bristle_damping * (v - elastic * (fabs(v) * g->inverse_level));
    }
    return force;
}

/* Moves the carriage over `span` seconds: bristles exactly at the middle's velocity, Simpson's rule for the position. */
static inline void move(struct stage *stage, double force, double acceleration, double span)
{
    double start = stage->velocity;
    double v = start + 0.5 * span * acceleration;
    double squared = v * v, slip = -fabs(v) * span, sign = copysign(1.0, v);
    double elastic = 0.0, damping_impulse = 0.0;
    for (int i = 0; i < GUIDES; i++) {
        struct guide *g = &stage->guides[i];
        double level = g->coulomb_force + g->stribeck_force * exp(g->exponent * squared);
        double inverse_level = 1.0 / level;
        double steady = level * g->compliance * sign;
        double bristle = steady + (g->bristle - steady) * exp(g->stiffness * inverse_level * slip);
        elastic += g->stiffness * (g->bristle + bristle);
        damping_impulse += g->bristle_damping * (bristle - g->bristle);
        g->bristle = bristle;
        g->inverse_level = inverse_level;
    }
    double sum = force - 0.5 * elastic - stage->viscous_friction * v;
    stage->velocity = start + stage->inverse_mass * (span * sum - damping_impulse);
    stage->position += span / 6.0 * (start + 4.0 * v + stage->velocity);
}

/* Takes up the state: 1/g at the present velocity. */
void lugre_start(struct stage *stage)
{
    for (int i = 0; i < GUIDES; i++) {
        struct guide *g = &stage->guides[i];
        g->inverse_level = 1.0 / (g->coulomb_force + g->stribeck_force * exp(g->exponent * stage->velocity * stage->velocity));
    }
}

/* Advances by `steps` steps under the constant force, N; a step in which the carriage reverses is done in two parts. */
void lugre_advance(struct stage *stage, double force, uint32_t steps)
{
    for (uint32_t k = 0; k < steps; k++) {
        double acceleration = (force - start_force(stage)) * stage->inverse_mass;
        double start = stage->velocity, end = start + stage->step * acceleration;
        if (start * end < 0.0) {
            double before = stage->step * start / (start - end);
            move(stage, force, acceleration, before);
            acceleration = (force - start_force(stage)) * stage->inverse_mass;
            move(stage, force, acceleration, stage->step - before);
        } else {
            move(stage, force, acceleration, stage->step);
        }
        stage->cell_force = force;
    }
}
