//! Antennas of this robot's card for bearings of what it hears alone.

use super::values::lists;
use csi5300::pipeline::{Array, ArrayError, ChainConstant};
use driver_iface::bfee::Antenna;
use nalgebra::Vector3;
use serde::Deserialize;

/// Two or three antennas, and where they are on the robot. See [`Array`].
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Antennas {
    /// The antennas, `["A", "B"]`; of cards other than the 5300 they are receive chains 0, 1 and 2.
    #[serde(deserialize_with = "antennas")]
    pub antennas: Vec<Antenna>,
    /// The place of the first one as seen from each other one: metres forward, left, up.
    #[serde(deserialize_with = "lists")]
    pub baselines_m: Vec<[f64; 3]>,
    /// Of each baseline what a turn gave: the constant between the chains and its deviation, degrees. With it a robot that stands
    /// has a bearing.
    #[serde(default, deserialize_with = "lists")]
    pub chain_constants_deg: Vec<[f64; 2]>,
}

fn antennas<'de, D: serde::Deserializer<'de>>(input: D) -> Result<Vec<Antenna>, D::Error> {
    #[derive(Deserialize)]
    struct One(#[serde(deserialize_with = "super::values::antenna")] Antenna);
    Ok(Vec::<One>::deserialize(input)?.into_iter().map(|one| one.0).collect())
}

impl Antennas {
    /// The array.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn array(&self) -> Result<Array, ArrayError> {
        let baselines_m: Vec<Vector3<f64>> = self.baselines_m.iter().map(|m| Vector3::from(*m)).collect();
        let constant = |[deg, sd_deg]: &[f64; 2]| ChainConstant { rad: deg.to_radians(), sd_rad: sd_deg.to_radians() };
        let constants: Vec<ChainConstant> = self.chain_constants_deg.iter().map(constant).collect();
        let array = Array::new(&self.antennas, &baselines_m)?;
        if constants.is_empty() { Ok(array) } else { array.with_constants(&constants) }
    }
}
