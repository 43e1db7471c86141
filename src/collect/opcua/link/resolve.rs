//! Which nodes the names of a configuration mean in this session.

use super::{Link, Lost, Refused, wrong_count};
use crate::collect::opcua::config::Place;
use crate::collect::opcua::names::{Namespaces, Pins};
use crate::collect::opcua::pins::ServerPins;
use opcua::types::{BrowsePath, BrowsePathResult, NodeId, ObjectId, VariableId, Variant};

/// The node of a place, or why there is none.
pub(in crate::collect::opcua) type Found = Result<NodeId, String>;

/// Browse paths, each with the number of its place.
type Paths = Vec<(usize, BrowsePath)>;

impl Link {
    /// The node of each place, by the namespaces that the server has now.
    pub(in crate::collect::opcua) async fn resolve(
        &mut self,
        places: &[Place],
        pins: &ServerPins,
    ) -> Result<Vec<Found>, Lost> {
        if places.is_empty() {
            return Ok(Vec::new());
        }
        let namespaces = self.namespaces().await?;
        let (mut found, paths) = pins.with(|pins| named(places, &namespaces, pins));
        let mut done = 0;
        while done < paths.len() {
            let batch: Vec<BrowsePath> =
                paths[done..].iter().take(self.limits.translate).map(|(_, path)| path.clone()).collect();
            match self.answer("browse paths", self.session.translate_browse_paths_to_node_ids(&batch)).await {
                Ok(answer) if answer.len() == batch.len() => {
                    for ((at, _), result) in paths[done..].iter().zip(answer) {
                        found[*at] = target(&result);
                    }
                    done += batch.len();
                }
                Ok(answer) => return Err(wrong_count("browse paths", batch.len(), answer.len())),
                Err(Refused::TooMany) if batch.len() > 1 => self.limits.translate = batch.len() / 2,
                Err(refused) => return Err(refused.into()),
            }
        }
        Ok(found)
    }

    /// The URIs of the namespaces by number, as the server tells them in this session.
    pub(in crate::collect::opcua) async fn namespaces(&mut self) -> Result<Namespaces, Lost> {
        let told = self.read(&[VariableId::Server_NamespaceArray.into()]).await?;
        let uris = match told.into_iter().next().and_then(|value| value.value) {
            Some(Variant::Array(array)) => array.values,
            _ => Vec::new(),
        };
        Ok(Namespaces(uris.iter().map(Variant::to_string).collect()))
    }
}

/// The node of each place that is named by one, and the paths of the others, which the server has to follow.
fn named(places: &[Place], namespaces: &Namespaces, pins: &mut Pins) -> (Vec<Found>, Paths) {
    let mut found = Vec::with_capacity(places.len());
    let mut paths = Paths::new();
    for (at, place) in places.iter().enumerate() {
        found.push(match place {
            Place::Node(name) => name.resolve(namespaces, pins),
            Place::Path(name) => name.resolve(namespaces, pins).and_then(|relative_path| {
                let starting_node = ObjectId::ObjectsFolder.into();
                paths.push((at, BrowsePath { starting_node, relative_path }));
                Err("path not found".into())
            }),
        });
    }
    (found, paths)
}

/// The node that a path leads to. One that leads to several, or out of this server, names none.
fn target(result: &BrowsePathResult) -> Found {
    match result.targets.as_deref().unwrap_or_default() {
        [one] if one.remaining_path_index == u32::MAX => Ok(one.target_id.node_id.clone()),
        [] => Err(format!("path not found: {}", result.status_code)),
        [_] => Err("path not found: it leads to another server".into()),
        several => Err(format!("path not found: it leads to {} nodes", several.len())),
    }
}
