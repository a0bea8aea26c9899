//! The true stage: carriage, guides and hidden effects as one set of ordinary differential
//! equations, integrated by the classical Runge-Kutta method of fourth order (Kutta 1901) with
//! fixed steps; a step in which the velocity changes its sign is divided there, because |v| has a
//! kink, and one in which a contact opens or closes is divided shortly before and after that,
//! because its force jumps.
//!
//! State: x, v, the bristles, the bristles of the shadows, the states of the effects. A shadow is
//! the friction law with one of the hidden effects left out, driven by the same motion; the
//! difference of the two forces is that effect's share.

use super::effects::{Drive, Effect, HELD, Now, Side};
use super::guides::{Change, Elements, GUIDES, Guide};
use super::noise::Noise;

/// Largest product of step and decay rate of a bristle; the method is stable to 2.78.
const STIFFEST: f64 = 1.2;
/// How far before and after a touch a step is divided, as a share of it: more than a secant misses
/// the instant by.
const SLIVER: f64 = 0.01;

/// A friction law with the effects that it knows.
#[derive(Debug, Clone)]
struct Friction {
    elements: Elements,
    without: Option<usize>,
    first: usize,
}

/// What acts at a moment, N, and how the carriage moves.
#[derive(Debug, Clone, Copy, Default)]
pub struct Moment {
    /// True position, m.
    pub position: f64,
    /// True velocity, m/s.
    pub velocity: f64,
    /// True acceleration, m/s^2.
    pub acceleration: f64,
    /// Force that the motor makes, N.
    pub motor_force: f64,
    /// Friction of the guides, N; positive opposes +v.
    pub friction_force: f64,
}

/// Stage with its effects.
#[derive(Debug, Clone)]
pub struct Stage {
    mass: f64,
    guides: [Guide; GUIDES],
    effects: Vec<Effect>,
    /// Indices of the effects in the order of the chain of the motor.
    chain: Vec<usize>,
    /// The true law first, then the shadows.
    frictions: Vec<Friction>,
    /// Where the states of each effect begin.
    places: Vec<usize>,
    state: Vec<f64>,
    work: [Vec<f64>; 5],
    commands: [f64; HELD],
    time: f64,
    ticks: u64,
    tick: f64,
    steps: usize,
}

impl Stage {
    /// At rest at x = 0 with relaxed bristles. `mass` in kg, `tick` is the interval of a command in
    /// s, `step` the longest of the integrator.
    pub fn new(
        mass: f64,
        guides: [Guide; GUIDES],
        effects: Vec<Effect>,
        tick: f64,
        step: f64,
    ) -> Self {
        let elements = |without: Option<usize>| {
            let kept = effects.iter().enumerate().filter(|(i, _)| Some(*i) != without);
            kept.filter_map(|(_, e)| e.elements()).next_back().unwrap_or_else(Elements::single)
        };
        let mut size = 2;
        let mut frictions = Vec::new();
        let changing =
            effects.iter().enumerate().filter(|(_, e)| e.changes_friction()).map(|(i, _)| Some(i));
        for without in std::iter::once(None).chain(changing) {
            let elements = elements(without);
            let first = size;
            size += elements.states();
            frictions.push(Friction { elements, without, first });
        }
        let mut places = Vec::new();
        for effect in &effects {
            places.push(size);
            size += effect.states();
        }
        let mut state = vec![0.0; size];
        for (effect, &place) in effects.iter().zip(&places) {
            effect.start(&mut state[place..place + effect.states()]);
        }
        let mut chain: Vec<usize> =
            (0..effects.len()).filter(|&i| effects[i].side() == Side::Motor).collect();
        chain.sort_by_key(|&i| effects[i].rank());
        Self {
            mass: mass + effects.iter().map(|e| e.added_mass()).sum::<f64>(),
            guides,
            effects,
            chain,
            frictions,
            places,
            work: std::array::from_fn(|_| state.clone()),
            state,
            commands: [0.0; HELD],
            time: 0.0,
            ticks: 0,
            tick,
            steps: (tick / step).ceil().max(1.0) as usize,
        }
    }

    /// Sets the deflection of each guide's bristle, m (of stages without distributed bristles).
    pub fn deflect(&mut self, z: [f64; GUIDES]) {
        self.state[2..2 + GUIDES].copy_from_slice(&z);
    }

    fn now<'a>(&'a self, time: f64, since: f64, state: &[f64]) -> Now<'a> {
        Now { time, x: state[0], v: state[1], since, tick: self.tick, commands: &self.commands }
    }

    fn states_of<'a>(&self, index: usize, state: &'a [f64]) -> &'a [f64] {
        &state[self.places[index]..self.places[index] + self.effects[index].states()]
    }

    fn change(&self, without: Option<usize>, now: &Now<'_>, state: &[f64]) -> Change {
        let mut change = Change::default();
        for (index, effect) in self.effects.iter().enumerate() {
            if Some(index) != without {
                effect.friction(now, self.states_of(index, state), &mut change);
            }
        }
        change
    }

    /// Rates of all states, and what acts.
    fn rates(&self, time: f64, since: f64, state: &[f64], rate: &mut [f64]) -> Moment {
        let now = self.now(time, since, state);
        let mut friction_force = 0.0;
        for friction in &self.frictions {
            let change = self.change(friction.without, &now, state);
            let place = friction.first..friction.first + friction.elements.states();
            let force = friction.elements.force(
                &self.guides,
                now.v,
                &change,
                &state[place.clone()],
                &mut rate[place],
            );
            if friction.without.is_none() {
                friction_force = force;
            }
        }
        let mut motor_force = now.held(0.0);
        for &index in &self.chain {
            motor_force =
                self.effects[index].motor(&now, motor_force, self.states_of(index, state));
        }
        let drive = Drive { friction_power: friction_force * now.v, motor_force };
        let mut force = motor_force - friction_force;
        for (index, effect) in self.effects.iter().enumerate() {
            let own = self.states_of(index, state);
            force += effect.carriage(&now, own);
            let place = self.places[index];
            effect.rate(&now, &drive, own, &mut rate[place..place + own.len()]);
        }
        rate[0] = now.v;
        let mass =
            self.mass + self.effects.iter().map(|effect| effect.added_mass_now(&now)).sum::<f64>();
        rate[1] = force / mass;
        Moment {
            position: now.x,
            velocity: now.v,
            acceleration: rate[1],
            motor_force,
            friction_force,
        }
    }

    /// One step of length `h` from the state in `work[0]` to `work[4]`; `work[1]` to `work[3]` are
    /// overwritten.
    fn runge_kutta(&self, work: &mut [Vec<f64>; 5], time: f64, since: f64, h: f64) {
        let [from, k, at, sum, to] = work;
        self.rates(time, since, from, k);
        sum.copy_from_slice(k);
        for (share, weight) in [(0.5, 2.0), (0.5, 2.0), (1.0, 1.0)] {
            for i in 0..from.len() {
                at[i] = from[i] + share * h * k[i];
            }
            self.rates(time + share * h, since, at, k);
            for i in 0..from.len() {
                sum[i] += weight * k[i];
            }
        }
        for i in 0..from.len() {
            to[i] = from[i] + h / 6.0 * sum[i];
        }
    }

    /// Steps that an interval needs at the speed of now.
    fn steps_now(&self) -> usize {
        let mut fastest: f64 = 0.0;
        for friction in &self.frictions {
            for &(stiffness, strength) in &friction.elements.shares {
                for guide in &self.guides {
                    fastest =
                        fastest.max(stiffness * guide.stiffness / (strength * guide.coulomb_force));
                }
            }
        }
        let speed = self.state[1].abs() + 50.0 * self.tick;
        self.steps.max((fastest * speed * self.tick / STIFFEST).ceil() as usize)
    }

    /// Ends of the steps of an interval, s since its start: equal steps, and the instants at which
    /// a late command comes.
    fn edges(&self) -> Vec<f64> {
        let steps = self.steps_now();
        let late = self
            .effects
            .iter()
            .filter_map(|effect| effect.delay())
            .map(|delay| delay.rem_euclid(self.tick));
        let mut edges: Vec<f64> =
            (0..=steps).map(|step| step as f64 * self.tick / steps as f64).chain(late).collect();
        edges.sort_by(f64::total_cmp);
        // Shorter steps than this are rounding.
        edges.dedup_by(|after, before| *after - *before < 1e-9 * self.tick);
        edges
    }

    /// Instants at which to divide a step of length `h` from the state in `work[0]` to that in
    /// `work[4]`, s since its start, in order.
    fn divisions(&self, work: &[Vec<f64>; 5], time: f64, since: f64, h: f64) -> Vec<f64> {
        let zero = |before: f64, after: f64| {
            (before * after < 0.0).then_some(h * before / (before - after))
        };
        let (from, to) = (&work[0], &work[4]);
        let mut divisions: Vec<f64> = zero(from[1], to[1]).into_iter().collect();
        let (start, end) = (self.now(time, since, from), self.now(time + h, since, to));
        let touches = self.effects.iter().enumerate().filter_map(|(index, effect)| {
            let before = effect.touch(&start, self.states_of(index, from))?;
            zero(before, effect.touch(&end, self.states_of(index, to))?)
        });
        divisions
            .extend(touches.flat_map(|at| [(at - SLIVER * h).max(0.0), (at + SLIVER * h).min(h)]));
        divisions.sort_by(f64::total_cmp);
        divisions
    }

    /// Holds a command (N) for one interval.
    pub fn advance(&mut self, command: f64, noise: &mut Noise) {
        self.commands.rotate_right(1);
        self.commands[0] = command;
        let mut work = std::mem::take(&mut self.work);
        work[0].copy_from_slice(&self.state);
        let start = self.ticks as f64 * self.tick;
        for ends in self.edges().windows(2) {
            let (since, h) = (ends[0], ends[1] - ends[0]);
            let middle = since + 0.5 * h;
            let time = start + since;
            self.runge_kutta(&mut work, time, middle, h);
            let divisions = self.divisions(&work, time, middle, h);
            let mut from = 0.0;
            for &to in &divisions {
                self.runge_kutta(&mut work, time + from, middle, to - from);
                work.swap(0, 4);
                from = to;
            }
            if !divisions.is_empty() {
                self.runge_kutta(&mut work, time + from, middle, h - from);
            }
            work.swap(0, 4);
        }
        self.state.copy_from_slice(&work[0]);
        self.work = work;
        self.ticks += 1;
        self.time = self.ticks as f64 * self.tick;
        let mut effects = std::mem::take(&mut self.effects);
        let now = self.now(self.time, self.tick, &self.state);
        for effect in &mut effects {
            effect.tick(&now, noise);
        }
        self.effects = effects;
    }

    /// What acts now, at the end of the interval of the last command; the force of each effect is
    /// written to `forces`, N, positive along +x: that of a motor effect is what it adds to the
    /// motor force, that of a carriage effect what it adds to the forces on a rigid carriage of the
    /// true mass, zero for sensors.
    pub fn moment(&self, forces: &mut [f64]) -> Moment {
        let mut rate = vec![0.0; self.state.len()];
        let moment = self.rates(self.time, self.tick, &self.state, &mut rate);
        let now = self.now(self.time, self.tick, &self.state);
        forces.fill(0.0);
        let mut force = now.held(0.0);
        for &index in &self.chain {
            let after = self.effects[index].motor(&now, force, self.states_of(index, &self.state));
            forces[index] = after - force;
            force = after;
        }
        for (index, effect) in
            self.effects.iter().enumerate().filter(|(_, e)| e.side() == Side::Carriage)
        {
            let added = effect.added_mass() + effect.added_mass_now(&now);
            forces[index] += effect.carriage(&now, self.states_of(index, &self.state))
                - added * moment.acceleration;
        }
        for friction in &self.frictions {
            if let Some(index) = friction.without {
                let change = self.change(friction.without, &now, &self.state);
                let place = friction.first..friction.first + friction.elements.states();
                let other = friction.elements.force(
                    &self.guides,
                    now.v,
                    &change,
                    &self.state[place.clone()],
                    &mut rate[place],
                );
                forces[index] += other - moment.friction_force;
            }
        }
        moment
    }

    /// Errors of encoder (m) and force cell (N) now, without noise, by effect: written to `encoder`
    /// and `cell`.
    pub fn reading_errors(&self, motor_force: f64, encoder: &mut [f64], cell: &mut [f64]) {
        let now = self.now(self.time, self.tick, &self.state);
        for (index, effect) in self.effects.iter().enumerate() {
            encoder[index] = effect.encoder(&now, motor_force);
            cell[index] = effect.cell(&now, motor_force, self.states_of(index, &self.state));
        }
    }
}
