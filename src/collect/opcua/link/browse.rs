//! What a server has below a node, for `probe`.

use super::{Link, Lost, Refused, wrong_count};
use opcua::types::{
    BrowseDescription, BrowseDirection, BrowseResult, ByteString, NodeId, ReferenceDescription,
    ReferenceTypeId,
};

/// Nodes that are browsed in one request, where the server takes as many.
const BATCH: usize = 50;
/// Objects and variables.
const CLASSES: u32 = 1 | 2;
/// Everything that is told of a reference.
const ALL_FIELDS: u32 = 0x3f;
/// Continuations of one node at most.
const MAX_PAGES: usize = 1000;

impl Link {
    /// The children of each node, properties left out; none where the server refuses a node.
    pub(in crate::collect::opcua) async fn children(
        &mut self,
        nodes: &[NodeId],
    ) -> Result<Vec<Vec<ReferenceDescription>>, Lost> {
        let mut found = Vec::with_capacity(nodes.len());
        let mut most = BATCH;
        while found.len() < nodes.len() {
            let batch: Vec<BrowseDescription> = nodes[found.len()..].iter().take(most).map(below).collect();
            match self.answer("browse", self.session.browse(&batch, 0, None)).await {
                Ok(answer) if answer.len() == batch.len() => {
                    for result in answer {
                        found.push(self.all_pages(result).await?);
                    }
                }
                Ok(answer) => return Err(wrong_count("browse", batch.len(), answer.len())),
                Err(Refused::TooMany) if batch.len() > 1 => most = batch.len() / 2,
                Err(refused) => return Err(refused.into()),
            }
        }
        Ok(found)
    }

    async fn all_pages(&self, first: BrowseResult) -> Result<Vec<ReferenceDescription>, Lost> {
        let mut all = first.references.unwrap_or_default();
        let mut next = first.continuation_point;
        for _ in 0..MAX_PAGES {
            if next.is_null_or_empty() {
                break;
            }
            let asked: [ByteString; 1] = [next];
            let answer = self.answer("browse further", self.session.browse_next(false, &asked)).await?;
            let Some(page) = answer.into_iter().next() else { break };
            all.extend(page.references.unwrap_or_default());
            next = page.continuation_point;
        }
        all.retain(|reference| reference.reference_type_id != ReferenceTypeId::HasProperty);
        Ok(all)
    }
}

fn below(node: &NodeId) -> BrowseDescription {
    BrowseDescription {
        node_id: node.clone(),
        browse_direction: BrowseDirection::Forward,
        reference_type_id: ReferenceTypeId::HierarchicalReferences.into(),
        include_subtypes: true,
        node_class_mask: CLASSES,
        result_mask: ALL_FIELDS,
    }
}
