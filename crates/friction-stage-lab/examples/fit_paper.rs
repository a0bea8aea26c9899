//! Fits guides with parallel bristles to all that the paper says of its guides, and prints each
//! datum with how it is met, the elements, and the values of the catalogue.
//!
//!     cargo run --release -p friction-stage-lab --example fit_paper

use friction_stage_lab::fit_paper;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let fit = fit_paper()?;
    println!(
        "{:13} {:9} {:>11} {:>11} {:>8}  what",
        "section", "kind", "found", "wanted", "residual"
    );
    for datum in &fit.data {
        println!(
            "{:13} {:9} {:11.4e} {:11.4e} {:8.2}  {}",
            datum.section,
            format!("{:?}", datum.kind).to_lowercase(),
            datum.found,
            datum.wanted,
            datum.residual(),
            datum.what
        );
    }
    println!("objective {:.4}", fit.objective);
    for (number, of) in (1..).zip(&fit.guides) {
        let (guide, effect) = of.parameters();
        println!("\nguide_{number}");
        for (stiffness, distance) in &of.elements {
            println!(
                "  {stiffness:.4e} N/m up to {:.4} µm: {:.4} N",
                1e6 * distance,
                stiffness * distance
            );
        }
        println!("  {guide:?}");
        for (name, value) in &effect.values {
            println!("  {name}: {value:?}");
        }
    }
    Ok(())
}
