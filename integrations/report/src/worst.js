// The worst places as a list that flies there.
import { element, percent, place } from './elements.js';

const NAMES = { noise: 'noise', systematic: 'systematic error', coverage: 'covered' };

/** `go( position, modeId, node )` */
export function worstList( report, comparison, go ) {

	const entry = ( title, position, mode, node ) => element( 'li', {}, element( 'button.link', { type: 'button', onclick: () => go( position, mode, node ) }, title ), element( 'span.hint', {}, ` ${ place( position ) }` ) );
	const groups = [];
	const add = ( title, entries ) => entries.length && groups.push( element( 'h3', {}, title ), element( 'ol', {}, entries ) );
	add( 'Moved most', ( comparison?.worst ?? [] ).map( ( { position, relative_error: error } ) => entry( percent( error ), position, 'difference' ) ) );
	add( 'Worst between nodes', report.worst_seen.map( ( { position, error, in_the_air: air } ) => entry( `${ percent( error, 0 ) } ${ air ? 'in the air' : 'on a surface' }`, position, 'seen' ) ) );
	for ( const { figure, nodes } of report.worst_nodes ) add( { noise: 'Noisiest nodes', systematic: 'Largest systematic error', coverage: 'Least covered nodes' }[ figure ], nodes.map( ( { node, position, value } ) => entry( `${ percent( value ) } ${ NAMES[ figure ] }, node ${ node }`, position, figure, node ) ) );
	return element( 'div.worst', {}, groups.length ? groups : element( 'p', {}, 'The file tells of no error by place.' ) );

}
