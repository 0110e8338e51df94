//! The classes of cases, by the word that selects them.

use crate::case::{self, Case, Hides};
use crate::dice::Dice;
use crate::many::Zeros;
use crate::mistakes::Mistake;
use crate::plan::Manner;
use crate::scene::Scene;
use crate::{changing, fast, heat, many, maps, mistakes, pairs, strangers};
use std::path::Path;

/// A class of cases.
#[derive(Clone, Copy, PartialEq, Eq, Debug, PartialOrd, Ord)]
pub enum Class {
    /// One effect of the dictionary, two, none, or a shape outside it.
    Narrow(Hides),
    /// A machine that was mapped finer or farther than it is measured now.
    Maps,
    /// Errors that follow the true temperature, with noisy sensors.
    Heat,
    /// Cycles of a few rows.
    Fast,
    /// Shapes over the position that are not a single wave.
    Changing,
    /// Shapes outside the dictionary.
    Strangers,
    /// Two effects over the wider experiments.
    Pairs,
    /// Three to seven effects in several records.
    Many,
    /// The same, where some records have a zero of their own.
    ManyZeros,
    /// The same, with a ballbar that is read along its bar.
    ManyRadial,
    /// Mistakes in the input, each with a case without it.
    Mistakes,
}

/// Every class with its word and its default number of cases.
/// The wider classes have cases only on request.
pub const CLASSES: [(Class, &str, usize); 14] = [
    (Class::Narrow(Hides::One), "one", 232),
    (Class::Narrow(Hides::Two), "two", 80),
    (Class::Narrow(Hides::Nothing), "null", 110),
    (Class::Narrow(Hides::Stranger), "stranger", 60),
    (Class::Maps, "maps", 100),
    (Class::Heat, "heat", 100),
    (Class::Fast, "fast", 100),
    (Class::Changing, "changing", 100),
    (Class::Strangers, "strangers", 100),
    (Class::Pairs, "pairs", 100),
    (Class::Many, "many", 100),
    (Class::ManyZeros, "many-zeros", 100),
    (Class::ManyRadial, "many-radial", 100),
    (Class::Mistakes, "mistakes", 98),
];

/// Draws after which another choice is drawn.
const PATIENCE: u32 = 60;

/// A case of a class, with its files.
pub struct Made {
    /// The files for the reconciler, and the right names.
    pub case: Case,
    /// The whole truth; `None` for the narrow classes.
    pub scene: Option<Scene>,
    /// The mistake, and the case without it.
    pub mistake: Option<(Mistake, Case)>,
}

impl Class {
    /// The word that selects the class.
    pub fn word(self) -> &'static str {
        CLASSES.iter().find(|(c, ..)| *c == self).map_or("", |(_, w, _)| w)
    }

    /// Makes the case of a seed and writes it into `dir`.
    ///
    /// # Errors
    /// When the directory cannot be written.
    pub fn make(self, seed: u64, manner: Manner, dir: &Path) -> anyhow::Result<Made> {
        if let Self::Narrow(hides) = self {
            let case = case::make(seed, hides, None, manner, dir)?;
            return Ok(Made { case, scene: None, mistake: None });
        }
        let (mut scene, mut dice) = self.scene(seed);
        scene.measure(&mut dice);
        if self == Self::Mistakes {
            let clean = scene.write(seed, &dir.join("clean"))?;
            let kind = seed as usize % mistakes::KINDS.len();
            let mistake = mistakes::spoil(&mut scene, kind, &mut dice);
            let case = scene.write(seed, &dir.join("mistaken"))?;
            return Ok(Made { case, scene: Some(scene), mistake: Some((mistake, clean)) });
        }
        let case = scene.write(seed, dir)?;
        Ok(Made { case, scene: Some(scene), mistake: None })
    }

    fn scene(self, seed: u64) -> (Scene, Dice) {
        let salt = CLASSES.iter().position(|(c, ..)| *c == self).unwrap_or(0) as u64;
        // The choice is drawn once, so that refused draws do not change the frequencies.
        let mut dice = Dice::new(seed ^ (salt + 1).wrapping_mul(0xD1B5_4A32_D192_ED03));
        let mut choice = dice.unit();
        for draw in 1.. {
            // Another choice, if this one seems impossible.
            if draw % PATIENCE == 0 {
                choice = dice.unit();
            }
            let drawn = match self {
                Self::Narrow(_) | Self::Maps => maps::scene(&mut dice, choice),
                Self::Heat => heat::scene(&mut dice, choice),
                Self::Fast => fast::scene(&mut dice, choice),
                Self::Changing => changing::scene(&mut dice, choice),
                Self::Strangers => strangers::scene(&mut dice, choice),
                Self::Pairs => pairs::scene(&mut dice),
                Self::Many => many::scene(&mut dice, choice, Zeros::Shared),
                Self::ManyZeros => many::scene(&mut dice, choice, Zeros::Own),
                Self::ManyRadial => many::scene(&mut dice, choice, Zeros::Radial),
                Self::Mistakes => mistakes::scene(&mut dice),
            };
            if let Some(scene) = drawn {
                return (scene, dice);
            }
        }
        unreachable!("the loop ends with a scene")
    }
}
