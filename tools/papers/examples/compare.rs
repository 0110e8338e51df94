//! Every table and figure of a source beside what the simulated machine gives now.
use rtec_papers::Paper;
use rtec_sim::described::Described;

#[cfg_attr(test, test)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let paper = Paper::find("cmti").ok_or("one of the sources")?;
    let found = paper.compare(&Described::default(), 1, &mut |step| println!("{step} …"))?;
    println!("{}: {} rows agree, {} differ", found.title, found.agree, found.differ);
    assert!(found.agree > 10 && found.rows.iter().all(|row| !row.place.is_empty()));
    Ok(())
}
