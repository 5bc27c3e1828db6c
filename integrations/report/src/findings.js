// What is wrong, first: the error as an engine shows it, findings, and how much of it is what.
import { element, percent, place, section } from './elements.js';

// Where somebody who lights levels begins to look.
const FAIR = 0.1, POOR = 0.3;
const grade = ( error ) => error <= FAIR ? 'good' : error <= POOR ? 'fair' : 'poor';

const REMEDIES = {
	noise: [ 'noise', 'more samples lessen it' ],
	between: [ 'light changing between nodes', 'a smaller spacing lessens it' ],
	bands: [ 'bands that are not stored', 'taking the sun out, or more bands, lessens it' ],
	packing: [ 'rounding of stored numbers', 'numbers of 16 bits lessen it' ],
};

function card( title, number, kind, ...lines ) {

	return element( `div.card.${ kind }`, {}, element( 'h3', {}, title ), element( 'p.figure', {}, number ), ...lines.map( ( line ) => element( 'p', {}, line ) ) );

}

function seenCard( title, set ) {

	const parts = Object.keys( REMEDIES ).sort( ( a, b ) => set.parts[ b ] - set.parts[ a ] );
	const [ what, remedy ] = REMEDIES[ parts[ 0 ] ];
	return card( `Light ${ title } is wrong by`, percent( set.error.median ), grade( set.error.p95 ),
		`at half of the ${ set.places } places; at 95 % of them by less than ${ percent( set.error.p95 ) }.`,
		`Worst: ${ percent( set.error.max, 0 ) } at ${ place( set.worst ) }.`,
		set.error.max > 0 ? `Most of it is ${ what }: ${ remedy }.` : '' );

}

export function findings( report ) {

	const { statistics, volume } = report;
	const cards = [];
	if ( statistics?.seen?.air ) cards.push( seenCard( 'in the air', statistics.seen.air ) );
	if ( statistics?.seen?.surfaces ) cards.push( seenCard( 'on surfaces', statistics.seen.surfaces ) );
	const noise = volume.relative_error;
	if ( noise ) cards.push( card( 'Noise of nodes', percent( noise.median ), grade( noise.p95 ), `median; 95 % of nodes are under ${ percent( noise.p95 ) }, the worst has ${ percent( noise.max ) }.` ) );
	const bias = statistics?.systematic_error;
	if ( bias?.max > 0 ) cards.push( card( 'Systematic error', percent( bias.median ), grade( bias.p95 ), `median; 95 % of nodes are under ${ percent( bias.p95 ) }. More samples do not take it away.` ) );
	const filled = volume.nodes - volume.nodes_valid;
	const standing = statistics?.standing;
	const why = standing ? ` ${ standing.solid } stand in solids, ${ standing.outside } outside, ${ standing.uncovered } see nothing that a probe has seen; ${ standing.moved } stepped aside.` : '';
	cards.push( card( 'Nodes', volume.nodes.toLocaleString( 'en' ), 'plain', `${ filled.toLocaleString( 'en' ) } of them have no light of their own and take it from their neighbours.${ why }` ) );
	const list = ( statistics?.findings ?? [] ).map( ( { id, count, message } ) => element( 'li', {}, element( 'b', {}, id ), count > 1 ? ` (${ count }): ` : ': ', message ) );
	return section( 'What is wrong',
		list.length ? element( 'ul.findings', {}, list ) : element( 'p', {}, 'The bake found nothing odd in its inputs.' ),
		element( 'div.cards', {}, cards ) );

}
