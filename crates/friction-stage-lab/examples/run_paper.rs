use friction_stage_lab::*;
fn main() {
    let names: Vec<String> = std::env::args().skip(2).collect();
    let seed = std::env::args().nth(1).unwrap().parse().unwrap();
    let specimens = names.iter().map(|n| Specimen::named(n).unwrap()).collect();
    let mut plan = ExperimentPlan::new(Experiment::Paper, specimens).unwrap();
    plan.settings.seed = seed;
    let found = plan.run::<LabError>(None, &|| ()).unwrap();
    for w in &found.warnings { println!("warning {w}"); }
    for s in &found.statements { println!("{} {} | {}\n      {}", if s.holds { "yes" } else { "NO " }, s.section, s.paper, s.stage); }
    println!("{} of {}", found.statements.iter().filter(|s| s.holds).count(), found.statements.len());
    if let Some(f) = found.stiffness_of_guide_1 { for e in f.errors { println!("{e:?}"); } }
}
