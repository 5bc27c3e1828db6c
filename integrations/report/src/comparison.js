// Two bakes: how far the first is from the second, and where it moved most.
import { element, percent, place, section, table } from './elements.js';

export function comparisonPart( { all, places, worst, noise_unknown: unknown }, volumes ) {

	const [ a, b ] = volumes.map( ( { name } ) => name );
	const node = all.per_node;
	const cards = [
		[ 'Irradiance differs by', percent( all.relative_rmse, 2 ), `root mean square over all directions and ${ places.compared.toLocaleString( 'en' ) } places, over that of ${ b }.` ],
		[ 'Half of the places', percent( node.median, 2 ), `or less; 95 % of them ${ percent( node.p95, 2 ) } or less; the worst ${ percent( node.max, 1 ) }.` ],
		[ 'On the whole', `${ all.bias >= 0 ? '+' : '−' }${ percent( Math.abs( all.bias ), 2 ) }`, `${ a } is ${ all.bias >= 0 ? 'brighter' : 'darker' } than ${ b }.` ],
	];
	if ( all.noise !== null ) cards.push( [ 'Expected from noise', percent( all.noise, 2 ), `by the standard errors of both. Beside noise ${ percent( all.systematic, 2 ) } are left, of which chance gives up to ${ percent( all.systematic_by_chance, 2 ) }.` ] );
	else if ( unknown?.length ) cards.push( [ 'Noise', 'not known', 'One file holds no standard errors, or both have the same seed, and so the same noise.' ] );
	return section( 'What moved',
		element( 'div.cards', {}, cards.map( ( [ title, number, text ] ) => element( 'div.card.plain', {}, element( 'h3', {}, title ), element( 'p.figure', {}, number ), element( 'p', {}, text ) ) ) ),
		worst.length ? table( [ 'moved most at', 'set', 'node', 'by' ], worst.map( ( { position, set, node: number, relative_error: error } ) => [ place( position ), set, String( number ), percent( error ) ] ), { numbers: [ 2, 3 ] } ) : null );

}
